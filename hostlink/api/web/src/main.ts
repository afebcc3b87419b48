/** Puts the parts of the page together. */

import "./style/frame.css";
import "./style/driving.css";
import "./style/showing.css";
import "./style/sizes.css";
import { Access } from "./access";
import { showClients } from "./clients";
import { Connection, type State } from "./connection";
import { digits, find, say } from "./dom";
import { Drive } from "./drive";
import { Fleet } from "./fleet";
import { Health } from "./health";
import { DeviceLog, type LogLine } from "./log";
import { RobotMap } from "./map";
import { notice } from "./notice";
import { Odometry } from "./odometry";
import { type PlotData, Plots } from "./plots";
import type { Refused } from "./rest";
import { RobotList } from "./robots";
import { Stop } from "./stop";
import { connectTheme } from "./theme";
import { takeTokenFromAddress, token } from "./token";
import { Tuning } from "./tuning";
import { topicOf } from "./views";

const STATES: Record<State, string> = {
  connecting: "connecting …",
  open: "connected",
  late: "no answer …",
  closed: "no connection",
};

const LOST = "hostlink does not answer. Trying again … What this page drove stops by itself.";
const FRESH_MS = 500;

takeTokenFromAddress();

const fleet = new Fleet(show, refuse);
const connection = new Connection(
  address,
  changed,
  (answer) => {
    drive.answered(answer);
    if (answer.kind === "NoRole") access.ask("This token does not drive", answer.reason ?? "");
  },
  (reason) => tuning.refused(reason),
);
const drive = new Drive(fleet, connection);
const stop = new Stop(fleet, drive.driving);
const robots = new RobotList(fleet, (robot) => drive.driver(robot));
const map = new RobotMap();
const plots = new Plots();
const odometry = new Odometry(fleet, (name) => map.forget(name));
const tuning = new Tuning(fleet, connection);
const health = new Health();
const log = new DeviceLog();
const access = new Access(() => connection.retryNow());

let watched = { odometry: "", plot: "" };
let isLost = false;
let unwatch: (() => void)[] = [];
let posedAt = Number.NEGATIVE_INFINITY; // the topic told a pose; the daemon's view is up to a question behind

connectTheme(() => {
  map.redraw();
  plots.recolour();
});
drive.connectInputs(() => stop.press());
connection.subscribe<LogLine>("/rosout", "rosgraph_msgs/Log", (line) => log.see(line));
connection.start();
fleet.start();
showClients();

function address(): string {
  const url = new URL("./", document.baseURI);
  url.protocol = url.protocol.replace("http", "ws");
  const secret = token();
  if (secret !== null) url.searchParams.set("token", secret);
  return url.href;
}

function changed(state: State): void {
  if (state === "late") drive.driving.letGo();
  else if (state !== "open") drive.forget();
  isLost = state === "open" ? false : state !== "connecting" || isLost;
  showConnection();
  drive.show();
}

/** Between two attempts it is still no connection. */
function showConnection(): void {
  const { state, roundTripMs } = connection;
  const shown = isLost && state === "connecting" ? "closed" : state;
  const isAsking = access.isAsking && state !== "open";
  document.body.classList.toggle("lost", isLost);
  find("#connection").dataset.state = shown;
  say(find("#connection .text"), isAsking ? "token needed" : STATES[shown]);
  say(find("#connection .detail"), roundTripMs === null ? "" : `${digits(roundTripMs, 0)} ms`);
  notice("connection", isLost && !isAsking ? LOST : null);
}

function refuse(refused: Refused): void {
  if (refused.status === 401) {
    access.ask("A token is needed", token() === null ? "Whoever runs this hostlink has one." : refused.message);
  } else if (refused.status === 403) access.ask("This is not allowed", refused.message);
  else notice("refused", refused.message, 3000);
}

/** Everything that comes from the daemon's views. */
function show(): void {
  const { robot, link } = fleet;
  watch();
  for (const each of fleet.robots) {
    const hasFreshPose = each === robot && performance.now() - posedAt < FRESH_MS;
    if (each.odometry && !hasFreshPose) map.see(each.name, each.odometry.pose);
    if (each.odometry && each === robot && !hasFreshPose) odometry.seePose(each.odometry.pose);
  }
  map.show(fleet.robots, robot?.name ?? null);
  drive.show();
  robots.show();
  stop.show();
  odometry.show();
  tuning.show();
  health.show(robot, fleet.links, connection.roundTripMs);
  find("#plots-note").hidden = !robot?.connected || !link || watched.plot !== "";
  showConnection();
  notice("robot", robot && !robot.connected ? `${robot.name} is not connected: it stands, or will soon.` : null);
}

/** Listen to the topics of the robot that is looked at. */
function watch(): void {
  const { robot, link } = fleet;
  const plot = robot ? topicOf(robot, link, "plot_data", "geometry_msgs/Twist") : null;
  const wanted = {
    odometry: robot?.odometry_topic ?? "",
    plot: plot ?? (robot?.connected && link ? "" : watched.plot),
  };
  if (wanted.odometry === watched.odometry && wanted.plot === watched.plot) return;
  if (wanted.plot !== watched.plot) plots.clear();
  for (const end of unwatch) end();
  watched = wanted;
  unwatch = [];
  posedAt = Number.NEGATIVE_INFINITY;
  if (robot && wanted.odometry) unwatch.push(connection.subscribe(wanted.odometry, "", seePose));
  if (wanted.plot) {
    unwatch.push(connection.subscribe<PlotData>(wanted.plot, "geometry_msgs/Twist", (data) => plots.see(data)));
  }
}

/** A geometry_msgs/Pose2D; of a nav_msgs/Odometry the daemon's view tells the pose. */
function seePose(message: { x?: number; y?: number; theta?: number }): void {
  const { robot } = fleet;
  if (robot === undefined) return;
  const { x, y, theta } = message;
  const pose =
    x !== undefined && y !== undefined && theta !== undefined
      ? { x_m: x, y_m: y, theta_rad: theta }
      : robot.odometry?.pose;
  if (pose === undefined) return;
  posedAt = performance.now();
  odometry.seePose(pose);
  map.see(robot.name, pose);
}
