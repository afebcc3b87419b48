/** The chart of a step: set-point and the speeds of both wheels, with the previous run as a ghost. */

import "./style/steps.css";
import { Chart, type Line } from "./chart";
import { find, make } from "./dom";
import { saveCsv } from "./download";
import { type Row, Series } from "./series";
import type { Sample } from "./step";
import { Timeline } from "./timeline";

const SPAN_S = 4; // of an empty chart
const LINES: Line[] = [
  { label: "left, previous", colour: "ghost-1" },
  { label: "right, previous", colour: "ghost-2" },
  { label: "set-point", colour: "muted", isDashed: true },
  { label: "left", colour: "accent" },
  { label: "right", colour: "second" },
];

export class StepChart {
  private readonly timeline = new Timeline(SPAN_S, [0, SPAN_S], 0);
  private readonly chart: Chart;
  private readonly save = find<HTMLButtonElement>("#step-csv");
  private run: Sample[][] = [];
  private before: Sample[][] = [];

  constructor() {
    const options = { name: "Wheel speed", unit: "ticks/s", least: 50, isSparse: true };
    this.chart = new Chart(this.timeline, LINES, options, new Series(LINES.length));
    find("#steps").prepend(make("div", { class: "charts" }, this.chart.figure));
    this.save.addEventListener("click", () => saveCsv("step.csv", NAMES, tableOf(this.run)));
  }

  /** Start a new run: the last one becomes the ghost, if it had any motion. */
  begin(): void {
    if (this.run.length > 0) this.before = this.run;
    this.run = [];
  }

  /** The run so far: samples of the left wheel, and of the right one. */
  show(run: Sample[][]): void {
    this.run = run.map((samples) => [...samples]);
    this.draw();
  }

  clear(): void {
    this.run = this.before = [];
    this.draw();
  }

  private draw(): void {
    const ghost = tableOf(this.before).map(([time, , left, , right]): Row => [time, left, right, null, null, null]);
    const present = tableOf(this.run).map(([time, set, left, , right]): Row => [time, null, null, set, left, right]);
    const series = new Series(LINES.length);
    for (const row of [...ghost, ...present].sort(([one], [other]) => one - other)) series.add(...row);
    const end = Math.max(SPAN_S, series.times.at(-1) ?? 0);
    this.save.disabled = this.run.length === 0;
    this.chart.show(series);
    this.timeline.show(0, end);
  }
}

const NAMES = ["time_s", "left_set_point", "left_measured", "right_set_point", "right_measured"];

function tableOf(run: Sample[][]): [number, number, number, number, number][] {
  const [left = [], right = []] = run;
  return left.map((sample, index) => {
    const other = right[index] ?? sample;
    return [sample.seconds, sample.setPoint, sample.measured, other.setPoint, other.measured];
  });
}
