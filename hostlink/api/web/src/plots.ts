/** Live plots of the robot's plot_data: set-point against measured speed of each wheel, and the PWM of both. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { digits, find, make } from "./dom";
import { colour } from "./theme";

const WINDOW_S = 20;
const GAP_S = 1; // a longer silence is not bridged by a line
const DRAW_MS = 100;
const MARKS_S = [20, 15, 10, 5, 0];
const MARKS = MARKS_S.map((mark_s) => (mark_s === 0 ? "now" : `−${mark_s} s`));

/** The robot's layout of a Twist: measured speeds, set-points, PWM. */
export interface PlotData {
  linear: { x: number; y: number; z: number };
  angular: { x: number; y: number; z: number };
}

interface Line {
  label: string;
  colour: string;
  isDashed?: boolean;
  read: (data: PlotData) => number;
}

interface Chart {
  plot: uPlot;
  lines: Line[];
  values: HTMLElement[];
  data: (number | null)[][];
}

const CHARTS: { id: string; least: number; lines: Line[] }[] = [
  {
    id: "#plot-left",
    least: 50,
    lines: [
      { label: "set-point", colour: "muted", isDashed: true, read: (data) => data.angular.x },
      { label: "measured", colour: "accent", read: (data) => data.linear.x },
    ],
  },
  {
    id: "#plot-right",
    least: 50,
    lines: [
      { label: "set-point", colour: "muted", isDashed: true, read: (data) => data.angular.y },
      { label: "measured", colour: "second", read: (data) => data.linear.y },
    ],
  },
  {
    id: "#plot-pwm",
    least: 500,
    lines: [
      { label: "left", colour: "accent", read: (data) => data.linear.z },
      { label: "right", colour: "second", read: (data) => data.angular.z },
    ],
  },
];

export class Plots {
  private times: number[] = [];
  private readonly charts: Chart[];
  private hasNews = false;

  constructor() {
    this.charts = CHARTS.map(({ id, least, lines }) => this.build(find(id), least, lines));
    setInterval(() => this.draw(), DRAW_MS);
  }

  add(data: PlotData): void {
    const now = performance.now() / 1000;
    const last = this.times.at(-1);
    if (last !== undefined && now - last > GAP_S) this.append(last + GAP_S / 2, () => null);
    this.append(now, (line) => line.read(data));
    this.hasNews = true;
  }

  /** What the plots showed before the page was opened, in front of what it has. */
  prepend(past: { age_s: number; msg: PlotData }[]): void {
    const now = performance.now() / 1000;
    const begin = this.times[0] ?? now;
    const older = past.map(({ age_s, msg }) => ({ time: now - age_s, msg })).filter(({ time }) => time < begin);
    this.times.unshift(...older.map(({ time }) => time));
    for (const { lines, data } of this.charts) {
      for (const [index, line] of lines.entries()) data[index]?.unshift(...older.map(({ msg }) => line.read(msg)));
    }
    this.hasNews = true;
  }

  /** Another robot, or none. */
  clear(): void {
    this.times = [];
    for (const chart of this.charts) chart.data = chart.lines.map(() => []);
    this.hasNews = true;
  }

  /** The colours are other ones. */
  recolour(): void {
    for (const { plot } of this.charts) plot.redraw(false, true);
  }

  private append(time: number, read: (line: Line) => number | null): void {
    this.times.push(time);
    for (const { lines, data } of this.charts) {
      for (const [index, line] of lines.entries()) data[index]?.push(read(line));
    }
    while ((this.times[0] ?? time) < time - WINDOW_S - GAP_S) {
      this.times.shift();
      for (const { data } of this.charts) for (const values of data) values.shift();
    }
  }

  private draw(): void {
    if (!this.hasNews || document.hidden) return;
    this.hasNews = false;
    for (const { plot, data, lines, values } of this.charts) {
      plot.setData([this.times, ...data]);
      plot.root.dataset.count = String(this.times.length);
      lines.forEach((_, index) => {
        const value = values[index];
        if (value) value.textContent = digits(data[index]?.at(-1), 0);
      });
    }
  }

  private build(figure: HTMLElement, least: number, lines: Line[]): Chart {
    const values = lines.map(() => make("b", {}, "–"));
    const legend = make("div", { class: "legend" });
    lines.forEach((line, index) => {
      const swatch = make("i", { class: `swatch ${line.colour}${line.isDashed ? " dashed" : ""}` });
      legend.append(make("span", {}, swatch, `${line.label} `, values[index] ?? ""));
    });
    const box = make("div", { class: "plot" });
    figure.append(legend, box);
    const plot = new uPlot(options(least, lines), [[], ...lines.map(() => [])], box);
    new ResizeObserver(() => plot.setSize({ width: box.clientWidth, height: box.clientHeight })).observe(box);
    return { plot, lines, values, data: lines.map(() => []) };
  }
}

function options(least: number, lines: Line[]): uPlot.Options {
  const axis: uPlot.Axis = {
    stroke: () => colour("muted"),
    grid: { stroke: () => colour("grid"), width: 1 },
    ticks: { show: false },
    font: "11px system-ui, sans-serif",
  };
  return {
    width: 100,
    height: 100,
    legend: { show: false },
    cursor: { show: false },
    padding: [6, 16, 0, 0],
    scales: {
      x: { time: false, range: (_, __, last) => [(last ?? WINDOW_S) - WINDOW_S, last ?? WINDOW_S] },
      y: { range: (_, low, high) => [Math.min(0, low ?? 0) * 1.1, Math.max(least, high ?? 0) * 1.1] },
    },
    axes: [
      { ...axis, size: 22, splits: (_, __, ___, now) => MARKS_S.map((mark_s) => now - mark_s), values: () => MARKS },
      { ...axis, size: 40, space: 30 },
    ],
    series: [
      {},
      ...lines.map((line): uPlot.Series => ({
        label: line.label,
        stroke: () => colour(line.colour),
        width: 1.75,
        ...(line.isDashed && { dash: [5, 4] }),
        points: { show: false },
      })),
    ],
  };
}
