/** Live plots of the chosen robot: commanded and measured velocity, and wheels and PWM from plot_data. */

import { ageText, find, make, setText } from "./dom";
import type { Fleet, RobotState } from "./fleet";
import { type HistoryView, valuesOf } from "./past";
import { RobotCharts } from "./robotcharts";
import { makeTimebar } from "./timebar";
import { now_s, type Timeline } from "./timeline";

const KEEP_S = 300;
const DRAW_MS = 100;
const NOTES: Record<RobotState, string> = {
  unknown: "no data",
  gone: "not connected",
  silent: "silent",
  locked: "",
  connected: "",
};

/** The robot's use of a Twist: measured speeds, set-points, PWM. */
export interface PlotData {
  linear: { x: number; y: number; z: number };
  angular: { x: number; y: number; z: number };
}

export class Plots {
  private readonly charts: RobotCharts;
  private readonly speeds = find("#speeds");
  private readonly note = make("p", { "data-bar": "", class: "hint" });
  private robot = "";

  constructor(
    private readonly fleet: Fleet,
    private readonly timeline: Timeline,
  ) {
    this.charts = new RobotCharts(timeline, KEEP_S);
    const { speedFigures, wheelFigures } = this.charts;
    this.speeds.append(this.note, makeBar(timeline, "Speeds"), make("div", { class: "charts" }, ...speedFigures));
    find("#plots").prepend(makeBar(timeline, "Wheels"), make("div", { class: "charts" }, ...wheelFigures));
    setInterval(() => timeline.isLive && !document.hidden && this.charts.redraw(), DRAW_MS);
  }

  /** Whether new data arrives. */
  showState(): boolean {
    const { robot } = this.fleet;
    const state = robot ? this.fleet.state(robot) : "gone";
    const isFresh = NOTES[state] === "";
    const hasAge = robot && (state === "silent" || state === "unknown");
    setText(this.note, robot ? NOTES[state] + (hasAge ? ` for ${ageText(this.fleet.age_s(robot))}` : "") : "");
    this.speeds.classList.toggle("stale", !isFresh);
    return isFresh;
  }

  /** Add new data of the chosen robot, which may have changed. */
  show(): void {
    const { robot } = this.fleet;
    if (robot && robot.name !== this.robot) {
      this.robot = robot.name;
      this.charts.clear();
    }
    const isFresh = this.showState();
    if (!robot?.connected) return;
    const { velocity } = robot;
    const done = isFresh ? robot.odometry?.twist : undefined;
    this.charts.speeds.add(
      now_s(),
      velocity.linear_m_s,
      done?.linear_m_s ?? null,
      velocity.angular_rad_s,
      done?.angular_rad_s ?? null,
    );
  }

  /** Whether the robot has plot_data. */
  showWheels(isMeasured: boolean): void {
    for (const figure of this.charts.wheelFigures) figure.hidden = !isMeasured;
  }

  add(data: PlotData): void {
    this.charts.wheels.add(now_s(), ...valuesOf(data));
  }

  prepend(robot: string, past: HistoryView): void {
    if (robot === this.robot) this.charts.prepend(past, now_s());
  }

  /** Redraw after a change of the colours. */
  recolour(): void {
    this.timeline.changed();
  }
}

/** For the bar of a panel. */
function makeBar(timeline: Timeline, name: string): HTMLElement {
  const bar = makeTimebar(timeline, name);
  bar.dataset.bar = "";
  return bar;
}
