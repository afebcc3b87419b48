/** The charts of one robot over a timeline: commanded and measured velocity, and its wheels from plot_data. */

import { Chart, type ChartOptions, type Line } from "./chart";
import { type HistoryView, plotRows, speedRows } from "./past";
import { Series } from "./series";
import type { Timeline } from "./timeline";

const SPEED_GAP_S = 2.5; // a stopped robot sends one sample a second
const PLOT_GAP_S = 1;

interface Kind {
  id: string;
  from: number; // first column
  lines: Line[];
  options: ChartOptions;
}

const ASKED: Line = { label: "commanded", colour: "muted", isDashed: true };
const SET_POINT: Line = { label: "set-point", colour: "muted", isDashed: true };
const DONE: Line = { label: "measured", colour: "accent" };

const SPEEDS: Kind[] = [
  {
    id: "plot-forward",
    from: 0,
    lines: [ASKED, DONE],
    options: { name: "Forward speed", unit: "m/s", places: 2, least: 0.1 },
  },
  {
    id: "plot-turn",
    from: 2,
    lines: [ASKED, DONE],
    options: { name: "Turn rate", unit: "rad/s", places: 2, least: 0.5 },
  },
];
const WHEELS: Kind[] = [
  { id: "plot-left", from: 0, lines: [SET_POINT, DONE], options: { name: "Left wheel", unit: "ticks/s", least: 50 } },
  {
    id: "plot-right",
    from: 2,
    lines: [SET_POINT, { label: "measured", colour: "second" }],
    options: { name: "Right wheel", unit: "ticks/s", least: 50 },
  },
  {
    id: "plot-pwm",
    from: 4,
    lines: [
      { label: "left", colour: "accent" },
      { label: "right", colour: "second" },
    ],
    options: { name: "PWM", unit: "of 4095", least: 500 },
  },
];

export class RobotCharts {
  readonly speeds: Series; // commanded and measured: forward, then turn
  readonly wheels: Series; // in the columns of valuesOf
  readonly speedFigures: HTMLElement[];
  readonly wheelFigures: HTMLElement[];

  private readonly charts: Chart[] = [];

  /** `prefix` of the figures' ids. */
  constructor(timeline: Timeline, keep_s: number, prefix = "") {
    this.speeds = new Series(4, keep_s, SPEED_GAP_S);
    this.wheels = new Series(6, keep_s, PLOT_GAP_S);
    const make = (kinds: Kind[], series: Series) =>
      kinds.map(({ id, from, lines, options }) => {
        const chart = new Chart(timeline, lines, options, series, from);
        chart.figure.id = prefix + id;
        this.charts.push(chart);
        return chart.figure;
      });
    this.speedFigures = make(SPEEDS, this.speeds);
    this.wheelFigures = make(WHEELS, this.wheels);
  }

  /** Add earlier samples in front. */
  prepend(past: HistoryView, zero_s: number): void {
    this.speeds.prepend(speedRows(past, zero_s));
    this.wheels.prepend(plotRows(past, zero_s));
    this.redraw();
  }

  clear(): void {
    this.speeds.clear();
    this.wheels.clear();
    this.redraw();
  }

  redraw(): void {
    for (const chart of this.charts) chart.redraw();
  }
}
