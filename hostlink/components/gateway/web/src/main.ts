/** Connects the parts of the page. */

import "./style/controls.css";
import "./style/frame.css";
import "./style/driving.css";
import "./style/showing.css";
import "./style/reasons.css";
import { Access } from "./access";
import { showClients } from "./clients";
import { Connection, type State } from "./connection";
import { ageText, digits, find, setText } from "./dom";
import { Drive } from "./drive";
import { Events } from "./events";
import { makeExpandable } from "./expandable";
import { Fleet } from "./fleet";
import { Followed } from "./followed";
import { Frame } from "./frame";
import { Health } from "./health";
import { History } from "./history";
import { DeviceLog } from "./log";
import { RobotMap } from "./map";
import { notice } from "./notice";
import { Odometry } from "./odometry";
import type { Page } from "./page";
import { type PlotData, Plots } from "./plots";
import type { Refused } from "./rest";
import { Rights } from "./rights";
import { RobotList } from "./robots";
import { Step } from "./step";
import { Stop } from "./stop";
import { connectTheme } from "./theme";
import { Timeline } from "./timeline";
import { moveTokenFromAddress, token } from "./token";
import { Tuning } from "./tuning";
import type { LogLine, RecordingNews } from "./views";
import { Waiting } from "./waiting";

const STATES: Record<State, string> = {
  connecting: "connecting …",
  open: "connected",
  late: "no answer …",
  closed: "no connection",
};

const SILENT = "hostlink does not answer. Trying again … The robot that this page drove stops by itself.";
const STARVED = "hostlink is connected but sends no events: close other tabs of this page. The stop works.";
const UNDRIVABLE = "This page cannot drive: it has no WebSocket to hostlink. Trying again … The stop works.";
const SPAN_S = 20; // shown by plots
const REFRESH_MS = 300; // for texts that change with time alone: recent drivers and refusals

moveTokenFromAddress();

const showListeners: (() => void)[] = [];
const logListeners: ((line: LogLine) => void)[] = [];
const recordingListeners: ((news: RecordingNews) => void)[] = [];
const refusalListeners: ((topic: string, reason: string) => void)[] = [];
const fleet = new Fleet(show);
const events = new Events(
  {
    robots: (data) => {
      fleet.receive(data.robots);
      show();
      showPoses();
      plots.show();
      log.observe(data.robots);
      history.show(data.robots, fleet.robot?.name);
    },
    links: (data) => {
      fleet.links = data.links;
      show();
    },
    clients: (data) => showClients(data.clients),
    recordings: (data) => recordingListeners.forEach((listener) => listener(data)),
    log: (line) => logListeners.forEach((listener) => listener(line)),
  },
  () => {
    fleet.isHeard = events.isHeard !== false && events.late_s === null;
    show();
    plots.showState();
  },
  refuse,
  (role) => rights.setRole(role),
);
const connection = new Connection(
  address,
  changed,
  (answer) => {
    drive.answered(answer);
    if (answer.kind === "NoRole") rights.setRole("read");
  },
  (reason, topic) => refusalListeners.forEach((listener) => listener(topic, reason)),
);
const rights = new Rights(show);
const drive = new Drive(fleet, connection, () => rights.canDrive);
const stop = new Stop(fleet, drive.driving);
const step = new Step(drive.driving);
const robots = new RobotList(
  fleet,
  (robot) => drive.driver(robot),
  (name) => stop.stopOne(name),
);
const timeline = new Timeline(SPAN_S);
const map = new RobotMap(fleet, timeline);
const plots = new Plots(fleet, timeline);
const odometry = new Odometry(fleet, (name) => map.forget(name));
const tuning = new Tuning(fleet, connection, () => rights.canDrive);
const health = new Health();
const waiting = new Waiting(fleet);
const plotData = new Followed<PlotData>(
  connection,
  "plot_data",
  "geometry_msgs/Twist",
  (data) => {
    plots.add(data);
    step.add(data);
  },
  () => step.forget(),
);
const errors = new Followed<{ data: number[] }>(
  connection,
  "errors",
  "std_msgs/UInt16MultiArray",
  ({ data }) => health.setErrors(data),
  () => health.setErrors(null),
);
const log = new DeviceLog(timeline);
const history = new History(map, plots, log);
const access = new Access(() => {
  connection.beginAnew();
  events.beginAnew();
});

const page: Page = {
  fleet,
  timeline,
  connection,
  driving: drive.driving,
  get canDrive() {
    return rights.canDrive;
  },
  onShow: (listener) => showListeners.push(listener),
  onLog: (listener) => logListeners.push(listener),
  onRefusal: (listener) => refusalListeners.push(listener),
  onRecordings: (listener) => recordingListeners.push(listener),
};
page.onLog((line) => log.add(line));
page.onRefusal((topic, reason) => tuning.refused(topic, reason));

let isCut = false; // the WebSocket was lost and has not reconnected
let cutAt = 0; // when it was lost, by the page's clock

const frame = new Frame(page, () => drive.driving.releaseAll());
for (const text of ["#drive-state", "#notice p"]) makeExpandable(find(text));
connectTheme(() => {
  map.redraw();
  plots.recolour();
});
drive.connectInputs(
  () => stop.stop(),
  () => stop.lock(),
);
find("#other-token").addEventListener("click", () =>
  access.show("Another token", "Enter a token that may drive.", true),
);
fleet.daemonHeardAt_ms = () => events.heardAt;
connection.start();
events.start();
performance.mark("hostlink.ready"); // the page is interactive from here on
setInterval(() => {
  drive.show();
  robots.show(events.isHeard);
  odometry.show(rights.canDrive);
  plots.showState();
  health.show(fleet, connection.roundTripMs);
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
  if (state === "closed") health.setErrors(null); // data of this connection is unknown now
  const wasCut = isCut;
  isCut = state === "open" ? false : state !== "connecting" || isCut;
  if (isCut && !wasCut) cutAt = performance.now();
  showConnection();
  drive.show();
}

/** The worse state of WebSocket and events. Between two attempts there is still no connection. */
function showConnection(): void {
  const { state, roundTripMs } = connection;
  const isSilent = events.isHeard === false;
  const { late_s } = events;
  const shown = isCut && state === "connecting" ? "closed" : isSilent && state === "open" ? "late" : state;
  const isAsking = access.isShown && state !== "open";
  document.body.classList.toggle("lost", isCut || isSilent || late_s !== null);
  find("#connection").dataset.state = shown;
  frame.showAges({ events: events.age_s, topics: isCut ? (performance.now() - cutAt) / 1000 : null });
  setText(find("#connection .text"), isAsking ? "token needed" : STATES[shown]);
  setText(find("#connection .detail"), roundTripMs === null ? "" : `${digits(roundTripMs, 0)} ms`);
  const slow =
    late_s === null ? null : `The connection is slow: what is shown is ${ageText(late_s)} old. The stop works.`;
  const silent = isSilent ? (state === "open" ? STARVED : SILENT) : null;
  notice("connection", isAsking ? null : (silent ?? (isCut ? UNDRIVABLE : slow)));
}

function refuse(refused: Refused): void {
  if (refused.status === 401) {
    access.show("A token is needed", token() === null ? "Ask the operator of this hostlink for one." : refused.message);
  } else if (refused.status === 403) access.show("Access refused", refused.message);
  else notice("refused", refused.message, 3000);
}

/** Handlers of the daemon's events. */
function show(): void {
  const { robot, link } = fleet;
  for (const followed of [plotData, errors]) followed.show(robot, link);
  map.show(robot?.name ?? null);
  drive.show();
  robots.show(events.isHeard);
  waiting.show();
  stop.show(rights.canDrive);
  odometry.show(rights.canDrive);
  tuning.show();
  step.show(rights.canDrive && robot?.connected === true && plotData.topic !== "");
  health.show(fleet, connection.roundTripMs);
  find("#plots-note").hidden = !robot?.connected || !link || plotData.topic !== "";
  plots.showWheels(plotData.topic !== "");
  for (const listener of showListeners) listener();
  showConnection();
  notice(
    "robot",
    robot && !robot.connected
      ? `${robot.name} is not connected. If its firmware has no watchdog, it may drive on.`
      : null,
  );
}

function showPoses(): void {
  for (const robot of fleet.robots) {
    if (robot.odometry?.pose) map.add(robot.name, robot.odometry.pose);
  }
}
