/** A step test: straight ahead at the top speed of the drive panel while a button is held, and its figures. */

import { digits, find, setText } from "./dom";
import type { Driving } from "./driving";
import type { PlotData } from "./plots";
import { StepChart } from "./stepchart";

const RISE = [0.1, 0.9] as const;
const STEADY_S = 0.5; // at the end of a step
const SETTLED = 0.05; // fraction of the target, in both directions
const LEAST_S = 1.5; // a shorter step has no figures
const MOST_S = 30; // a longer step is ended
const STANDING = 1.5; // ticks/s of a stopped wheel
const TICK_MS = 80;
const LONGEST_PAUSE_MS = 400; // of this page; the robot has stopped after a lease of 500 ms
const SILENCE_MS = 1000; // without plot_data nothing is measured
const HELD_KEY = "Enter"; // Space stops

export interface Sample {
  seconds: number; // since the button was pressed
  setPoint: number;
  measured: number;
}

interface Figures {
  rise: number | null; // s; null: not reached
  overshoot: number; // percent
  settled: number | null; // s; null: not reached
  steady: number; // mean deviation at the end, percent; negative: too fast
}

const WHEELS: { row: string; read: (data: PlotData) => [setPoint: number, measured: number] }[] = [
  { row: "#step-left", read: (data) => [data.angular.x, data.linear.x] },
  { row: "#step-right", read: (data) => [data.angular.y, data.linear.y] },
];

export class Step {
  private readonly button = find<HTMLButtonElement>("#step");
  private readonly state = find("#step-state");
  private pressedAt: number | null = null; // null: no step is running
  private ranAt = 0;
  private measuredAt = 0;
  private newest: PlotData | null = null;
  private samples: Sample[][] = WHEELS.map(() => []);
  private readonly chart = new StepChart();

  constructor(private readonly driving: Driving) {
    this.button.addEventListener("pointerdown", (event) => {
      if (event.button === 0) this.press();
    });
    this.button.addEventListener("keydown", (event) => {
      if (event.key === HELD_KEY && !event.repeat) this.press();
    });
    this.button.addEventListener("keyup", (event) => event.key === HELD_KEY && this.release());
    for (const lost of ["pointerleave", "blur"]) this.button.addEventListener(lost, () => this.release());
    // on the window: a button that becomes disabled gets no events
    for (const lost of ["pointerup", "pointercancel", "blur", "pagehide"]) {
      addEventListener(lost, () => this.release());
    }
    document.addEventListener("visibilitychange", () => this.release());
    setInterval(() => this.check(), TICK_MS);
  }

  /** Only a robot with plot_data can be measured. */
  show(isMeasured: boolean): void {
    this.button.disabled = !isMeasured;
    if (isMeasured) return;
    this.newest = null;
    this.release();
  }

  /** Reset: plot_data of another robot follows, or none. */
  forget(): void {
    this.discard("");
    this.newest = null;
    this.chart.clear();
    for (const { row } of WHEELS) showFigures(row, null);
  }

  add(data: PlotData): void {
    this.newest = data;
    this.check(); // a message may arrive before the timer
    if (this.pressedAt === null) return;
    this.measuredAt = performance.now();
    const seconds = (performance.now() - this.pressedAt) / 1000;
    WHEELS.forEach(({ read }, index) => {
      const [setPoint, measured] = read(data);
      this.samples[index]?.push({ seconds, setPoint, measured });
    });
    this.chart.show(this.samples);
    if (seconds > MOST_S || !this.driving.holds("step")) this.release(); // or a stop or a refusal ended it
  }

  private press(): void {
    if (this.button.disabled || this.pressedAt !== null) return;
    const { newest } = this;
    if (newest === null || WHEELS.some(({ read }) => read(newest).some((speed) => !isStanding(speed)))) {
      setText(this.state, "Stop the robot before a step.");
      return;
    }
    this.pressedAt = this.ranAt = this.measuredAt = performance.now();
    this.samples = WHEELS.map(() => []);
    setText(this.state, "Hold until the speed is steady.");
    this.chart.begin();
    this.driving.hold("step", { forward: 1, turn: 0 });
  }

  /** Discard the step after a pause, or without plot_data: a step is one continuous, observed motion. */
  private check(): void {
    const now = performance.now();
    const pause = now - this.ranAt;
    this.ranAt = now;
    if (this.pressedAt === null) return;
    if (pause > LONGEST_PAUSE_MS) this.discard(`This page did not run for ${digits(pause / 1000, 1)} s: press again.`);
    else if (now - this.measuredAt > SILENCE_MS) this.discard("plot_data is missing: release the button.");
  }

  private discard(reason: string): void {
    this.samples = WHEELS.map(() => []);
    this.release();
    setText(this.state, reason);
  }

  private release(): void {
    this.driving.release("step");
    if (this.pressedAt === null) return;
    this.pressedAt = null;
    const shown = WHEELS.map(({ row }, index) => showFigures(row, figuresOf(this.samples[index] ?? [])));
    setText(this.state, shown.every(Boolean) ? "" : "Too short: hold until the speed is steady.");
  }
}

/** null: the device sent an invalid number. */
function isStanding(speed: number | null): boolean {
  return speed !== null && Math.abs(speed) <= STANDING;
}

function showFigures(row: string, figures: Figures | null): boolean {
  const cells = find(row).querySelectorAll("td");
  const texts =
    figures === null
      ? ["–", "–", "–", "–"]
      : [
          seconds(figures.rise),
          `${digits(figures.overshoot, 1)} %`,
          seconds(figures.settled),
          `${digits(figures.steady, 1)} %`,
        ];
  cells.forEach((cell, index) => setText(cell, texts[index] ?? ""));
  return figures !== null;
}

function seconds(value: number | null): string {
  return value === null ? "never" : `${digits(value, 2)} s`;
}

/** As in `hostlink step`: docs/tuning.md. */
function figuresOf(samples: Sample[]): Figures | null {
  const last = samples.at(-1);
  const moving = samples.filter(({ setPoint }) => setPoint !== 0).at(-1);
  if (last === undefined || moving === undefined || last.seconds < LEAST_S) return null;
  const target = moving.setPoint;
  const shares = samples.map((sample) => ({ seconds: sample.seconds, share: sample.measured / target }));
  const [begin, end] = RISE.map((level) => crossing(shares, level));
  const settled = shares.map(({ share }) => Math.abs(share - 1) > SETTLED).lastIndexOf(true) + 1;
  return {
    rise: begin == null || end == null ? null : end - begin,
    overshoot: Math.max(0, ...shares.map(({ share }) => 100 * (share - 1))),
    settled: shares[settled]?.seconds ?? null,
    steady: steadyError(samples, moving.seconds, target),
  };
}

/** Mean over the last samples with the whole target. */
function steadyError(samples: Sample[], end_s: number, target: number): number {
  const steady = samples.filter(({ seconds, setPoint }) => seconds > end_s - STEADY_S && setPoint === target);
  const missing = steady.reduce((sum, { measured }) => sum + (target - measured), 0);
  return (100 * missing) / (Math.max(1, steady.length) * target);
}

/** Time when a fraction of the target is first reached, interpolated between two samples. */
function crossing(shares: { seconds: number; share: number }[], level: number): number | null {
  const at = shares.findIndex(({ share }) => share >= level);
  const [before, after] = [shares[at - 1], shares[at]];
  if (after === undefined) return null;
  if (before === undefined) return after.seconds;
  const part = (level - before.share) / (after.share - before.share);
  return before.seconds + part * (after.seconds - before.seconds);
}
