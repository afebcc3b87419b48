// Drives a robot with Foxglove's client until the process ends: node foxglove_drive.mjs URL TOPIC
import protocol from "@foxglove/ws-protocol";
import { WebSocket } from "ws";

const [url, topic] = process.argv.slice(2);
const client = new protocol.FoxgloveClient({ ws: new WebSocket(url, ["foxglove.sdk.v1"]) });
client.on("advertise", (channels) => {
  if (!channels.some((channel) => channel.topic === topic)) return;
  const id = client.advertise({ topic, encoding: "ros1", schemaName: "geometry_msgs/Twist" });
  const twist = new Uint8Array(new Float64Array([0.2, 0, 0, 0, 0, 0]).buffer);
  setInterval(() => client.sendMessage(id, twist), 50);
});
