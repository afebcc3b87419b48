/** Puts the parts of the page together. */

import "./style/frame.css";
import "./style/driving.css";
import "./style/showing.css";
import "./style/sizes.css";
import { Access } from "./access";
import { showClients } from "./clients";
import { Connection, type State } from "./connection";
import { digits, find, setText } from "./dom";
import { Drive } from "./drive";
import { Events } from "./events";
import { Fleet } from "./fleet";
import { Followed } from "./followed";
import { type BatteryState, Health } from "./health";
import { History } from "./history";
import { DeviceLog } from "./log";
import { RobotMap } from "./map";
import { notice } from "./notice";
import { Odometry } from "./odometry";
import { type PlotData, Plots } from "./plots";
import type { Refused } from "./rest";
import { RobotList } from "./robots";
import { Step } from "./step";
import { Stop } from "./stop";
import { connectTheme } from "./theme";
import { moveTokenFromAddress, token } from "./token";
import { Tuning } from "./tuning";

const STATES: Record<State, string> = {
  connecting: "connecting …",
  open: "connected",
  late: "no answer …",
  closed: "no connection",
};

const SILENT = "hostlink does not answer. Trying again … What this page drove stops by itself.";
const STARVED = "No events come from hostlink, though it is connected: close other tabs of this page. The stop works.";
const UNDRIVABLE = "This page cannot drive: it has no WebSocket to hostlink. Trying again … The stop works.";
const REFRESH_MS = 300; // what changes with time alone: who drove just now, why it was refused

moveTokenFromAddress();

const fleet = new Fleet(show);
const events = new Events(
  {
    robots: (data) => {
      fleet.robots = data.robots;
      fleet.isKnown = true;
      show();
      showPoses();
      history.show(data.robots);
    },
    links: (data) => {
      fleet.links = data.links;
      show();
    },
    clients: (data) => showClients(data.clients),
    log: (line) => log.add(line),
  },
  show,
  refuse,
);
const connection = new Connection(
  address,
  changed,
  (answer) => {
    drive.answered(answer);
    if (answer.kind === "NoRole") access.show("This token does not drive", answer.reason ?? "");
  },
  (reason) => tuning.refused(reason),
);
const drive = new Drive(fleet, connection);
const stop = new Stop(fleet, drive.driving);
const step = new Step(drive.driving);
const robots = new RobotList(fleet, (robot) => drive.driver(robot));
const map = new RobotMap();
const plots = new Plots();
const odometry = new Odometry(fleet, (name) => map.forget(name));
const tuning = new Tuning(fleet, connection);
const health = new Health();
const plotData = new Followed<PlotData>(
  connection,
  "plot_data",
  "geometry_msgs/Twist",
  (data) => {
    plots.add(data);
    step.add(data);
  },
  () => plots.clear(),
);
const battery = new Followed<BatteryState>(
  connection,
  "battery",
  "sensor_msgs/BatteryState",
  (state) => health.setBattery(state.voltage),
  () => health.setBattery(null),
);
const errors = new Followed<{ data: number[] }>(
  connection,
  "errors",
  "std_msgs/UInt16MultiArray",
  ({ data }) => health.setErrors(data),
  () => health.setErrors(null),
);
const log = new DeviceLog();
const history = new History(map, plots, log, (name) => fleet.robot?.name === name);
const access = new Access(() => {
  connection.retryNow();
  events.retryNow();
});

let isCut = false; // the WebSocket was lost, and is not there again

connectTheme(() => {
  map.redraw();
  plots.recolour();
});
drive.connectInputs(() => stop.press());
connection.start();
events.start();
setInterval(() => {
  drive.show();
  robots.show(events.isHeard);
  showConnection();
}, REFRESH_MS);

function address(): string {
  const url = new URL("./", document.baseURI);
  url.protocol = url.protocol.replace("http", "ws");
  const secret = token();
  if (secret !== null) url.searchParams.set("token", secret);
  return url.href;
}

function changed(state: State): void {
  if (state === "late") drive.driving.releaseAll();
  else if (state !== "open") drive.forget();
  isCut = state === "open" ? false : state !== "connecting" || isCut;
  showConnection();
  drive.show();
}

/** The worse of what WebSocket and events show. Between two attempts it is still no connection. */
function showConnection(): void {
  const { state, roundTripMs } = connection;
  const isSilent = events.isHeard === false;
  const shown = isCut && state === "connecting" ? "closed" : isSilent && state === "open" ? "late" : state;
  const isAsking = access.isShown && state !== "open";
  document.body.classList.toggle("lost", isCut || isSilent);
  find("#connection").dataset.state = shown;
  setText(find("#connection .text"), isAsking ? "token needed" : STATES[shown]);
  setText(find("#connection .detail"), roundTripMs === null ? "" : `${digits(roundTripMs, 0)} ms`);
  notice("connection", isAsking ? null : isSilent ? (state === "open" ? STARVED : SILENT) : isCut ? UNDRIVABLE : null);
}

function refuse(refused: Refused): void {
  if (refused.status === 401) {
    access.show("A token is needed", token() === null ? "Whoever runs this hostlink has one." : refused.message);
  } else if (refused.status === 403) access.show("This is not allowed", refused.message);
  else notice("refused", refused.message, 3000);
}

/** Everything that comes from the daemon's events. */
function show(): void {
  const { robot, link } = fleet;
  for (const followed of [plotData, battery, errors]) followed.show(robot, link);
  map.show(fleet.robots, robot?.name ?? null);
  drive.show();
  robots.show(events.isHeard);
  stop.show();
  odometry.show();
  tuning.show();
  step.show(robot?.connected === true && plotData.topic !== "");
  health.show(robot, fleet.links, connection.roundTripMs);
  find("#plots-note").hidden = !robot?.connected || !link || plotData.topic !== "";
  showConnection();
  notice("robot", robot && !robot.connected ? `${robot.name} is not connected: it stands, or will soon.` : null);
}

function showPoses(): void {
  for (const robot of fleet.robots) {
    if (robot.odometry) map.add(robot.name, robot.odometry.pose);
  }
}
