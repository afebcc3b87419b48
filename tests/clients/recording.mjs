// A recording as Foxglove reads one from a URL: node recording.mjs URL
// Prints what its channels hold, with the number of requests and bytes, as one JSON object.
import * as mcap from "@mcap/core";
import * as support from "@mcap/support";
import rosmsg from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg-serialization";

const [url] = process.argv.slice(2);
const headers = { Origin: "https://app.foxglove.dev" };
const seen = { requests: 0, bytes: 0, topics: {} };

const whole = new AbortController(); // its head alone is read
const head = await fetch(url, { headers, cache: "no-store", signal: whole.signal });
seen.head = [head.status, head.headers.get("accept-ranges"), Number(head.headers.get("content-length"))];
whole.abort();

const readable = {
  size: async () => BigInt(seen.head[2]),
  read: async (offset, length) => {
    const range = `bytes=${offset}-${offset + length - 1n}`;
    const answer = await fetch(url, { headers: { ...headers, range } });
    if (answer.status !== 206) throw new Error(`${range}: ${answer.status}`);
    seen.requests += 1;
    const data = new Uint8Array(await answer.arrayBuffer());
    seen.bytes += data.byteLength;
    return data;
  },
};
const reader = await mcap.McapIndexedReader.Initialize({ readable, decompressHandlers: await support.loadDecompressHandlers() });
seen.profile = reader.header.profile;
const decoders = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const text = new TextDecoder().decode(schema.data);
  decoders.set(channel.id, schema.encoding === "ros1msg"
    ? ((messages) => (data) => messages.readMessage(data))(new serialization.MessageReader(rosmsg.parse(text)))
    : (data) => JSON.parse(new TextDecoder().decode(data)));
}
for await (const { channelId, data } of reader.readMessages()) {
  const { topic } = reader.channelsById.get(channelId);
  (seen.topics[topic] ??= []).push(decoders.get(channelId)(data));
}
seen.topics = Object.fromEntries(Object.entries(seen.topics).map(([topic, all]) => [topic, { count: all.length, last: all.at(-1) }]));
console.log(JSON.stringify(seen, (_, value) => (typeof value === "bigint" ? Number(value) : value)));
