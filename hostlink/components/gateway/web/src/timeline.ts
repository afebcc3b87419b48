/**
 * The shown part of time and the cursor's instant, shared by all plots, the map and the log.
 *
 * It follows the present, or is paused. The timeline of a recording is always paused.
 */

const SPAN_S = { least: 0.5, most: 300 };

const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600]; // of an axis
const SLEPT_S = 2; // a smaller difference is clock drift

let slept_s = 0; // the page's clock may stop while the computer sleeps

/** Seconds since 1970 by a monotonic clock. */
export function now_s(): number {
  const awake_s = (performance.timeOrigin + performance.now()) / 1000;
  const ahead_s = Date.now() / 1000 - awake_s;
  if (ahead_s > slept_s + SLEPT_S) slept_s = ahead_s;
  return awake_s + slept_s;
}

export class Timeline {
  cursor_s: number | null = null; // null: the newest value

  private end_s: number | null = null; // null: follows the present
  private readonly listeners = new Set<() => void>();

  /** `whole`: begin and end of a recording. `zero_s`: origin of the times; null: time of day. */
  constructor(
    private span_s: number,
    private readonly whole: [begin_s: number, end_s: number] | null = null,
    readonly zero_s: number | null = null,
  ) {
    this.end_s = whole?.[1] ?? null;
  }

  get isLive(): boolean {
    return this.end_s === null;
  }

  get isStored(): boolean {
    return this.whole !== null;
  }

  get range(): [begin_s: number, end_s: number] {
    const end = this.end_s ?? now_s();
    return [end - this.span_s, end];
  }

  /** Call the function on each change until the returned function is called. */
  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  pause(): void {
    if (this.isLive) this.set(now_s(), this.span_s);
  }

  /** Follow the present; of a recording, show all. */
  resume(): void {
    this.cursor_s = null;
    if (this.whole) this.set(this.whole[1], this.whole[1] - this.whole[0]);
    else this.set(null, this.span_s);
  }

  show(begin_s: number, end_s: number): void {
    this.set(end_s, end_s - begin_s);
  }

  /** Zoom by a factor (above one shows less time). The instant at the cursor stays in place. */
  zoom(factor: number): void {
    const [begin, end] = this.range;
    const most = this.whole ? this.whole[1] - this.whole[0] : SPAN_S.most;
    const span = Math.min(most, Math.max(SPAN_S.least, this.span_s / factor));
    const centre = this.cursor_s ?? (begin + end) / 2;
    const share = this.span_s > 0 ? (end - centre) / this.span_s : 0;
    this.set(this.isLive ? null : centre + share * span, span);
  }

  /** Set the cursor to an instant; null removes it. */
  point(time_s: number | null): void {
    if (time_s === this.cursor_s) return;
    this.cursor_s = time_s;
    this.changed();
  }

  /** Positions of the marks of an axis: round numbers, at least as far apart as their texts are wide. */
  marks(begin_s: number, end_s: number, width: number): number[] {
    const least = ((end_s - begin_s) * (this.isClock ? 76 : 52)) / Math.max(1, width);
    const step = STEPS_S.find((each) => each >= least) ?? 86400;
    const zero = this.isClock ? 0 : (this.zero_s ?? end_s);
    const marks = [];
    for (let index = Math.ceil((begin_s - zero) / step - 1e-6); zero + index * step <= end_s + 1e-6; index++) {
      marks.push(zero + index * step);
    }
    return marks;
  }

  /** Text of a mark: seconds relative to now or to the beginning, or the time of day. */
  label(time_s: number, places = 0): string {
    if (this.isClock) return clock(time_s, places);
    const seconds = time_s - (this.zero_s ?? this.range[1]);
    if (Math.abs(seconds) < 0.05) return this.zero_s === null ? "now" : "0 s";
    const text = Math.abs(seconds).toFixed(
      Number.isInteger(Math.round(seconds * 10) / 10) ? places : Math.max(1, places),
    );
    return `${seconds < 0 ? "−" : this.zero_s === null ? "" : "+"}${text} s`;
  }

  /** Redraw after a change that is not of time. */
  changed(): void {
    for (const listener of this.listeners) listener();
  }

  private get isClock(): boolean {
    return this.zero_s === null && !this.isLive;
  }

  private set(end_s: number | null, span_s: number): void {
    this.end_s = end_s;
    this.span_s = Math.max(SPAN_S.least, span_s);
    this.changed();
  }
}

/** The time of day. */
export function clock(time_s: number, places = 0): string {
  const date = new Date(time_s * 1000);
  const fraction = places > 0 ? (time_s % 1).toFixed(places).slice(1, 2 + places) : "";
  return date.toLocaleTimeString([], { hour12: false }) + fraction;
}
