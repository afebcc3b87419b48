// Everything that Foxglove's own packages offer, done once against a daemon: node foxglove.mjs URL RECORDING
// Prints "cut" when its connections are to be cut, and at the end what it has observed as one JSON object.
import protocol from "@foxglove/ws-protocol";
import rosmsg from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg-serialization";
import { WebSocket } from "ws";

const { FoxgloveClient } = protocol;
const { parse } = rosmsg;
const { MessageReader, MessageWriter } = serialization;
const [url, subprotocol] = process.argv.slice(2);
const seen = {};
const until = async (isSo) => {
  while (!isSo()) await new Promise((resolve) => setTimeout(resolve, 20));
};

class Player {
  constructor() {
    this.socket = new WebSocket(url, [subprotocol]);
    this.client = new FoxgloveClient({ ws: this.socket });
    this.channels = new Map(); // by topic
    this.services = new Map(); // by name
    this.received = new Map(); // by topic, decoded
    this.statuses = [];
    this.removed = [];
    this.errors = [];
    this.graph = { published: {}, subscribed: {}, services: {}, removed: [] };
    this.parameters = new Map();
    this.answers = new Map();
    this.times = [];
    this.closed = false;
    const subscriptions = (this.subscriptions = new Map());
    const on = (event, act) => this.client.on(event, act);
    on("serverInfo", (info) => (this.info = info));
    on("error", (error) => this.errors.push(String(error)));
    on("close", () => (this.closed = true));
    on("status", (status) => this.statuses.push(status));
    on("removeStatus", ({ statusIds }) => this.removed.push(...statusIds));
    on("advertise", (channels) => channels.forEach((each) => this.channels.set(each.topic, each)));
    on("unadvertise", (ids) =>
      [...this.channels.values()].filter(({ id }) => ids.includes(id)).forEach(({ topic }) => this.channels.delete(topic)));
    on("advertiseServices", (services) => services.forEach((each) => this.services.set(each.name, each)));
    on("unadvertiseServices", (ids) =>
      [...this.services.values()].filter(({ id }) => ids.includes(id)).forEach(({ name }) => this.services.delete(name)));
    on("time", ({ timestamp }) => this.times.push(timestamp));
    on("message", ({ subscriptionId, timestamp, data }) => {
      const { topic, reader } = subscriptions.get(subscriptionId);
      this.behind = Math.max(this.behind ?? 0, Math.abs(Number(timestamp - this.times.at(-1)) / 1e6));
      this.received.set(topic, [...(this.received.get(topic) ?? []), { at: Number(timestamp / 1000000n), value: reader.readMessage(data) }]);
    });
    on("parameterValues", ({ parameters, id }) => {
      parameters.forEach((each) => this.parameters.set(each.name, each));
      if (id) this.answers.set(id, parameters);
    });
    on("serviceCallResponse", (response) => this.answers.set(response.callId, response));
    on("serviceCallFailure", (failure) => this.answers.set(failure.callId, failure));
    on("connectionGraphUpdate", (update) => {
      for (const { name, publisherIds } of update.publishedTopics) this.graph.published[name] = publisherIds;
      for (const { name, subscriberIds } of update.subscribedTopics) this.graph.subscribed[name] = subscriberIds;
      for (const { name, providerIds } of update.advertisedServices) this.graph.services[name] = providerIds;
      this.graph.removed.push(...update.removedTopics);
    });
  }

  async subscribe(topic) {
    await until(() => this.channels.has(topic));
    const channel = this.channels.get(topic);
    const id = this.client.subscribe(channel.id);
    this.subscriptions.set(id, { topic, reader: new MessageReader(parse(channel.schema)) });
    return id;
  }

  newest(topic) {
    return this.received.get(topic)?.at(-1)?.value;
  }

  async next(topic) {
    await until(() => this.received.get(topic)?.length);
    return this.newest(topic);
  }

  publisher(topic, schemaName, schema) {
    const id = this.client.advertise({ topic, encoding: "ros1", schemaName, schema, schemaEncoding: "ros1msg" });
    const writer = new MessageWriter(parse(schema));
    const publish = (value) => this.client.sendMessage(id, writer.writeMessage(value));
    return { id, publish, unadvertise: () => this.client.unadvertise(id) };
  }

  async call(name, request, callId) {
    await until(() => this.services.has(name));
    const service = this.services.get(name);
    const data = new MessageWriter(parse(service.request.schema)).writeMessage(request);
    this.client.sendServiceCallRequest({ serviceId: service.id, callId, encoding: "ros1", data });
    await until(() => this.answers.has(callId));
    const answer = this.answers.get(callId);
    return answer.op === "serviceCallFailure"
      ? { failure: answer.message }
      : { encoding: answer.encoding, ...new MessageReader(parse(service.response.schema)).readMessage(answer.data) };
  }
}

const player = new Player();
const other = new Player();
await until(() => player.info && other.info);
seen.info = player.info;
seen.protocol = player.socket.protocol;
seen.isSameSession = player.info.sessionId === other.info.sessionId;

// -- every channel is subscribed, and its schema understood
await until(() => player.channels.has("/robot_0/odom") && player.channels.has("/rosout"));
const twist = player.channels.get("/robot_0/cmd_vel").schema;
for (const topic of player.channels.keys()) await player.subscribe(topic);
seen.channels = Object.fromEntries(
  [...player.channels.values()].map(({ topic, encoding, schemaName, schemaEncoding }) => [topic, [encoding, schemaName, schemaEncoding]]));

// -- a velocity drives the robot
const velocity = player.publisher("/robot_0/cmd_vel", "geometry_msgs/Twist", twist);
const forward = { linear: { x: 0.3, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } };
const driving = setInterval(() => velocity.publish(forward), 100);
await until(() => player.newest("/robot_0/odom")?.pose.pose.position.x > 0.05);
await until(() => player.newest("/robot_0/cmd_vel")?.linear.x === 0.3);
seen.odom = player.newest("/robot_0/odom");
seen.age = Date.now() - player.received.get("/robot_0/odom").at(-1).at;
seen.time = { behind: player.behind, age: Date.now() - Number(player.times.at(-1) / 1000000n) };
clearInterval(driving);
await until(() => player.newest("/robot_0/cmd_vel").linear.x === 0); // the lease has ended
seen.decoded = Object.fromEntries([...player.received].map(([topic, messages]) => [topic, messages.length]));

// -- a lock refuses it, and the reason is shown once until it is accepted again
seen.lock = await player.call("/robot_0/lock", {}, 1);
for (let number = 0; number < 3; number += 1) velocity.publish(forward);
await until(() => player.statuses.length > 0);
seen.unlock = await player.call("/robot_0/unlock", {}, 2);
seen.refused = player.statuses;
velocity.publish({ ...forward, linear: { x: 0, y: 0, z: 0 } }); // a stream that met a lock begins anew with a zero
velocity.publish(forward);
await until(() => player.removed.length > 0);
seen.removed = player.removed;
velocity.unadvertise();

// -- topics and services between clients; what comes later is advertised, and what goes is not
const text = other.publisher("/chat", "std_msgs/String", "string data\n");
const chatting = setInterval(() => text.publish({ data: "hällo" }), 50);
await player.subscribe("/chat");
seen.text = (await player.next("/chat")).data;
clearInterval(chatting);
text.unadvertise();
await until(() => !player.channels.has("/chat"));
seen.services = [...player.services].map(([name, { type }]) => [name, type]);
seen.unknown = await new Promise((resolve) => {
  player.client.on("serviceCallFailure", ({ message }) => resolve(message));
  player.client.sendServiceCallRequest({ serviceId: 12345, callId: 9, encoding: "ros1", data: new Uint8Array() });
});

// -- parameters
other.client.setParameters([{ name: "/gain", value: 1 }], "first");
await until(() => other.answers.has("first"));
player.client.getParameters([], "all");
await until(() => player.answers.has("all"));
seen.parameters = player.answers.get("all");
player.client.subscribeParameterUpdates(["/gain"]);
player.client.getParameters(["/gain"], "subscribed");
await until(() => player.answers.has("subscribed"));
other.client.setParameters([{ name: "/gain", value: 2, type: "float64" }], "second");
await until(() => player.parameters.get("/gain")?.value === 2);
seen.gain = player.parameters.get("/gain");
other.client.setParameters([{ name: "/gain", value: undefined }], "third");
await until(() => player.parameters.get("/gain")?.value === undefined);

// -- the connection graph
player.client.subscribeConnectionGraph();
await until(() => player.graph.published["/robot_0/odometry"]);
const late = other.publisher("/late", "std_msgs/String", "string data\n");
await until(() => player.graph.published["/late"]);
late.unadvertise();
await until(() => player.graph.removed.includes("/late"));
seen.graph = { ...player.graph };
player.client.unsubscribeConnectionGraph();

// -- a mistake, and a connection that is cut
player.statuses = [];
player.client.subscribe(99999);
await until(() => player.statuses.length > 0);
seen.mistake = player.statuses[0];
console.log("cut");
await until(() => player.closed && other.closed);
seen.errors = player.errors;
const again = new Player();
await again.subscribe("/robot_0/odometry");
await again.next("/robot_0/odometry");
seen.reconnected = again.info.sessionId === player.info.sessionId;
console.log(JSON.stringify(seen, (_, value) => (typeof value === "bigint" ? Number(value) : value)));
process.exit(0);
