/** A chart of lines over a timeline. Its legend shows the values at the cursor, or the newest ones. */

import "./style/time.css";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { digits, make, setText } from "./dom";
import { onceAFrame } from "./redraw";
import type { Series, Value } from "./series";
import { colour } from "./theme";
import type { Timeline } from "./timeline";

const WIDTH_OF_NUMBERS = 44; // for the numbers at the left
const LEAST_DRAG_PX = 8; // a shorter drag is a click

export interface Line {
  label: string;
  colour: string; // variable of the style sheet
  isDashed?: boolean;
}

export interface ChartOptions {
  name: string;
  unit?: string;
  places?: number; // decimal places of the values
  least?: number; // smallest range of the vertical axis
  isFromZero?: boolean;
  isSparse?: boolean; // whether a column has values only at some times, which its line connects
}

export class Chart {
  readonly figure: HTMLElement;

  /** Called when the timeline has changed. */
  readonly redraw = onceAFrame(() => this.figure.checkVisibility() && this.draw());

  private readonly plot: uPlot;
  private readonly values: HTMLElement[];
  private series: Series;
  private readonly forget: () => void;

  constructor(
    private readonly timeline: Timeline,
    private readonly lines: Line[],
    private readonly options: ChartOptions,
    series: Series,
    private readonly from = 0, // first column of the series
  ) {
    this.series = series;
    this.values = lines.map(() => make("b", {}, "–"));
    const legend = make("div", { class: "legend" });
    lines.forEach((line, index) => {
      const swatch = make("i", { class: `swatch ${line.colour}${line.isDashed ? " dashed" : ""}` });
      legend.append(make("span", {}, swatch, `${line.label} `, this.values[index] ?? ""));
    });
    const box = make("div", { class: "plot", role: "img", "aria-label": `${options.name}: plot` });
    const caption = make("figcaption", {}, make("h3", {}, options.name), make("span", {}, options.unit ?? ""));
    this.figure = make("figure", { class: "chart" }, caption, legend, box);
    this.plot = new uPlot(this.uplotOptions(), [[], ...lines.map(() => [])], box);
    this.connectPointer(this.plot.over);
    new ResizeObserver(() => {
      if (box.clientWidth > 0) this.plot.setSize({ width: box.clientWidth, height: box.clientHeight });
    }).observe(box);
    this.forget = timeline.onChange(this.redraw);
  }

  /** Stop drawing. */
  destroy(): void {
    this.forget();
    this.plot.destroy();
    this.figure.remove();
  }

  /** Draw these lines from now on. */
  show(series: Series): void {
    this.series = series;
    this.redraw();
  }

  private draw(): void {
    const { plot, series, timeline } = this;
    const columns = series.columns.slice(this.from, this.from + this.lines.length);
    plot.setData([series.times, ...columns]);
    plot.root.dataset.count = String(series.times.length);
    const at = timeline.cursor_s === null ? series.times.length - 1 : series.indexAt(timeline.cursor_s);
    this.values.forEach((value, index) => {
      setText(value, digits(valueAt(columns[index] ?? [], at, this.options.isSparse), this.options.places ?? 0));
    });
  }

  private connectPointer(over: HTMLElement): void {
    const { timeline, plot } = this;
    const point = (event: PointerEvent) => timeline.point(plot.posToVal(event.offsetX, "x"));
    over.addEventListener("pointermove", point);
    over.addEventListener("pointerdown", point);
    over.addEventListener("pointerleave", () => timeline.isLive && timeline.point(null));
    over.addEventListener("dblclick", () => timeline.resume());
    over.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && !event.altKey) return; // a plain wheel scrolls the page
        event.preventDefault();
        timeline.zoom(1.002 ** -event.deltaY);
      },
      { passive: false },
    );
  }

  private uplotOptions(): uPlot.Options {
    const { timeline } = this;
    const { least = 1, isFromZero = true } = this.options;
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
      cursor: {
        x: false,
        y: false,
        points: { show: false },
        drag: { x: true, y: false, setScale: false, dist: LEAST_DRAG_PX },
        bind: { dblclick: () => null },
      },
      padding: [6, 18, 0, 0],
      scales: {
        x: { time: false, range: () => timeline.range },
        y: { range: (_, low, high) => verticalRange(low, high, least, isFromZero) },
      },
      axes: [
        {
          ...axis,
          size: 22,
          splits: (plot, _, begin, end) => timeline.marks(begin, end, plot.width - WIDTH_OF_NUMBERS),
          values: (_, marks) => marks.map((mark) => timeline.label(mark)),
        },
        { ...axis, size: WIDTH_OF_NUMBERS, space: (...[, , , , height]) => Math.max(30, height / 10) },
      ],
      series: [{}, ...this.lines.map((line) => seriesOf(line, this.options.isSparse === true))],
      hooks: {
        draw: [(plot) => drawCursor(plot, timeline)],
        setSelect: [
          (plot) => {
            const { left, width } = plot.select;
            if (width < LEAST_DRAG_PX) return;
            plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
            timeline.show(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
          },
        ],
      },
    };
  }
}

/** Return the value at an index; of a sparse column the newest value before it. */
function valueAt(column: Value[], at: number | null, isSparse = false): Value {
  for (let index = at ?? -1; index >= 0; index--) {
    const value = column[index] ?? null;
    if (value !== null || !isSparse) return value;
  }
  return null;
}

function seriesOf(line: Line, spanGaps: boolean): uPlot.Series {
  return {
    label: line.label,
    spanGaps,
    stroke: () => colour(line.colour),
    width: 1.75,
    ...(line.isDashed && { dash: [5, 4] }),
    points: { show: false },
  };
}

function verticalRange(low: number | null, high: number | null, least: number, isFromZero: boolean): [number, number] {
  const [bottom, top] = isFromZero ? [Math.min(0, low ?? 0), Math.max(0, high ?? 0)] : [low ?? 0, high ?? 0];
  const missing = Math.max(0, least - (top - bottom));
  const margin = Math.max(top - bottom, least) * 0.08;
  if (isFromZero && bottom === 0) return [0, top + missing + margin];
  return [bottom - missing / 2 - margin, top + missing / 2 + margin];
}

function drawCursor(plot: uPlot, timeline: Timeline): void {
  const marks: [time_s: number | null, colour: string][] = [
    [timeline.isStored ? timeline.zero_s : null, "axis"],
    [timeline.cursor_s, "text"],
  ];
  const { ctx: c } = plot;
  const { left, top, width, height } = plot.bbox;
  for (const [time_s, name] of marks) {
    const x = time_s === null ? -1 : Math.round(plot.valToPos(time_s, "x", true)) + 0.5;
    if (x < left || x > left + width) continue;
    c.save();
    c.strokeStyle = colour(name);
    c.lineWidth = devicePixelRatio;
    c.beginPath();
    c.moveTo(x, top);
    c.lineTo(x, top + height);
    c.stroke();
    c.restore();
  }
}
