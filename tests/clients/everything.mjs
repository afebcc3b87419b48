// Everything that roslib offers, done once against a daemon: node everything.mjs URL LIBRARY
// Prints "cut" when its connections are to be cut, and at the end what it has seen as one JSON object.
const [url, library] = process.argv.slice(2);
const module = await import(library);
const { Ros, Topic, Service, Param, ...rest } = module.default ?? module;
const seen = {};

// A callback and an error callback at the end of the arguments, as every call of roslib has them, as a promise.
const ask = (object, method, ...args) =>
  new Promise((resolve, reject) => object[method](...args, resolve, (error) => reject(new Error(`${method}: ${error}`))));
const once = (object, event) => new Promise((resolve) => object.once(event, resolve));
const opened = (ros) => once(ros, "connection");
const connected = async () => {
  const ros = new Ros({ url });
  ros.on("error", () => {});
  await opened(ros);
  return ros;
};
const next = (topic) => new Promise((resolve) => topic.subscribe(resolve));
const until = async (isSo) => {
  while (!isSo()) await new Promise((resolve) => setTimeout(resolve, 20));
};

const ros = await connected();
const other = await connected();

// -- topics both ways, with a robot at the end of one of them
const odometry = new Topic({ ros, name: "robot_0/odometry", messageType: "geometry_msgs/Pose2D" });
seen.pose = await next(odometry);
odometry.unsubscribe();
const velocity = new Topic({ ros, name: "/robot_0/cmd_vel", messageType: "geometry_msgs/Twist" });
velocity.advertise();
const odom = new Topic({ ros: other, name: "/robot_0/odom", messageType: "nav_msgs/Odometry" });
let newest = null;
odom.subscribe((message) => (newest = message));
const driving = setInterval(() => velocity.publish({ linear: { x: 0.3 }, angular: {} }), 100);
await until(() => newest && newest.pose.pose.position.x > 0.05);
clearInterval(driving);
seen.odom = newest;
odom.unsubscribe();
velocity.unadvertise();

// -- topics between clients, plain and as CBOR, latched, throttled
const pair = (name, messageType, options = {}) => [
  new Topic({ ros, name, messageType, latch: options.latch }),
  new Topic({ ros: other, name, messageType, ...options }),
];
const exchange = async (name, messageType, message, options) => {
  const [speaker, listener] = pair(name, messageType, options);
  const heard = next(listener);
  const saying = setInterval(() => speaker.publish(message), 50);
  const got = await heard;
  clearInterval(saying);
  listener.unsubscribe();
  speaker.unadvertise();
  return got;
};
seen.text = (await exchange("/chat", "std_msgs/String", { data: "hällo" })).data;
seen.image = (await exchange("/image", "sensor_msgs/CompressedImage", { format: "x", data: "AQID" })).data;
const floats = await exchange("/floats", "std_msgs/Float32MultiArray", { data: [1.5, -2] }, { compression: "cbor" });
seen.floats = { kind: floats.data.constructor.name, values: [...floats.data] };
const bytes = await exchange("/bytes", "std_msgs/UInt8MultiArray", { data: "AQID" }, { compression: "cbor" });
seen.bytes = { kind: bytes.data.constructor.name, values: [...bytes.data] };
const wide = await exchange("/wide", "std_msgs/Int64MultiArray", { data: [7, -7] }, { compression: "cbor" });
seen.wide = [...wide.data].map(Number);
const raw = await exchange("/raw", "std_msgs/String", { data: "abc" }, { compression: "cbor-raw" });
seen.raw = Buffer.from(raw.bytes).toString("hex");
seen.png = (await exchange("/png", "std_msgs/String", { data: "plain" }, { compression: "png" })).data;
const [latched, late] = pair("/latched", "std_msgs/String", { latch: true });
latched.publish({ data: "kept" });
await ask(ros, "getTopics");
seen.latched = (await next(late)).data;
const slow = new Topic({ ros: other, name: "/fast", messageType: "std_msgs/Int32", throttle_rate: 300, queue_length: 1 });
const fast = new Topic({ ros, name: "/fast", messageType: "std_msgs/Int32" });
const numbers = [];
slow.subscribe((message) => numbers.push(message.data));
await ask(other, "getTopics");
for (let number = 0; number < 10; number += 1) fast.publish({ data: number });
await until(() => numbers.length === 2);
seen.throttled = numbers;

// -- services, as caller and as server
const offer = new Service({ ros, name: "/add", serviceType: "std_srvs/SetBool" });
offer.advertise((request, response) => {
  response.message = `got ${request.data}`;
  response.success = request.data;
  return true;
});
await ask(ros, "getServices");
const caller = new Service({ ros: other, name: "/add", serviceType: "std_srvs/SetBool" });
seen.answer = await ask(caller, "callService", { data: true });
offer.unadvertise();
await ask(ros, "getServices");
seen.refused = await ask(caller, "callService", { data: true }).catch((error) => error.message);
seen.lock = await ask(new Service({ ros, name: "/robot_0/lock", serviceType: "std_srvs/Trigger" }), "callService", {});
const emit = ros.emit;
const locked = new Promise((resolve) => { // a status, for which nobody has asked, is an event with the id of its message
  ros.emit = (event, ...values) => {
    if (String(event).startsWith("status:publish:")) resolve(values[0]);
    return emit.call(ros, event, ...values);
  };
});
for (let number = 0; number < 3; number += 1) velocity.publish({ linear: { x: 0.3 }, angular: {} });
seen.locked = await locked;
ros.emit = emit;
velocity.unadvertise();
await ask(new Service({ ros, name: "/robot_0/unlock", serviceType: "std_srvs/Trigger" }), "callService", {});

// -- rosapi and parameters
seen.api = {};
for (const [method, ...args] of [
  ["getTopics"], ["getTopicsForType", "geometry_msgs/Twist"], ["getTopicType", "/robot_0/odometry"],
  ["getTopicsAndRawTypes"], ["getServices"], ["getServicesForType", "rosapi/Topics"], ["getServiceType", "/rosapi/topics"],
  ["getServiceRequestDetails", "rosapi/GetParam"], ["getServiceResponseDetails", "rosapi/GetTime"], ["getActionServers"],
  ["getNodes"], ["getNodeDetails", "/robot_0"], ["getMessageDetails", "nav_msgs/Odometry"], ["getParams"],
]) {
  // roslib 1 hands out the details of a node as three arguments
  seen.api[method] = await new Promise((resolve, reject) =>
    ros[method](...args, (...values) => resolve(values.length > 1 ? values : values[0]), reject));
}
const decoded = ros.decodeTypeDefs(seen.api.getMessageDetails.typedefs ?? seen.api.getMessageDetails);
seen.decoded = { x: decoded.pose.pose.position.x, covariance: decoded.pose.covariance, frame: decoded.header.frame_id };
const param = new Param({ ros, name: "/gain" });
const set = (value) => (library === "roslib" ? ask(param, "set", value) : new Promise((done) => param.set(value, done)));
await set([1, 2.5]);
seen.param = await new Promise((resolve) => param.get(resolve));
await new Promise((resolve) => param.delete(resolve));
seen.deleted = await new Promise((resolve) => param.get(resolve));

// -- status, authentication, an action, and a connection that is cut
const told = once(ros, "status");
ros.setStatusLevel("error");
ros.authenticate("mac", "client", "dest", "rand", 0, "level", 1);
ros.callOnConnection({ op: "dance" });
seen.status = (await told).msg;
if (rest.Action) {
  const dock = new rest.Action({ ros, name: "/dock", actionType: "x/Dock" });
  seen.action = await new Promise((resolve) => dock.sendGoal({}, resolve, undefined, resolve));
}
const steady = new Topic({ ros, name: "/robot_0/odometry", messageType: "geometry_msgs/Pose2D", reconnect_on_close: true });
let poses = 0;
steady.subscribe(() => (poses += 1));
await until(() => poses > 0);
const closed = once(ros, "close");
console.log("cut");
await closed;
poses = 0;
const again = opened(ros);
ros.connect(url);
await again;
await until(() => poses > 0);
seen.reconnected = true;
console.log(JSON.stringify(seen));
process.exit(0);
