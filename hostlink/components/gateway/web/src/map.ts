/** The map: a grid in metres, the driven paths, the robots, and a scale. */

import { ageText, digits, find } from "./dom";
import type { Fleet, RobotState } from "./fleet";
import { PathLayer } from "./map_paths";
import { drawGhost, drawRobot } from "./map_robot";
import { type Box, placeLabels } from "./map_labels";
import { type PastPose, Path } from "./path";
import { onceAFrame } from "./redraw";
import { robotPaint } from "./robot_colours";
import { colour } from "./theme";
import { now_s, type Timeline } from "./timeline";
import { boxAround, lengthText, roundUp, Viewport } from "./viewport";
import type { Pose, RobotView } from "./views";

const GRID_PX = 56; // smallest distance of grid lines
const BODY_M = 0.105; // half of the paper's robot
const LEAST_BODY_PX = 9;
const SCALE_PX = 64;
const SCALE_TEXT_PX = 18;
const DESCRIBE_MS = 1000;
const LABEL_PX = 13;
const AGE_MS = 200; // interval of redrawing old data

const LABEL_COLOURS: Record<RobotState, string> = {
  unknown: "muted",
  connected: "text",
  locked: "danger-text",
  silent: "warn-text",
  gone: "danger-text",
};

export class RobotMap {
  readonly redraw = onceAFrame(() => {
    if (this.view.isFitting && this.view.fit(boxAround(this.everything()), this.isCalm.matches)) this.redraw();
    this.draw();
  });

  private readonly canvas = find<HTMLCanvasElement>("#map-canvas");
  private readonly context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private readonly view = new Viewport();
  private readonly layer = new PathLayer();
  private readonly paths = new Map<string, Path>();
  private readonly isCalm = matchMedia("(prefers-reduced-motion: reduce)");
  private selected: string | null = null;
  private buttons: Box = { left: 0, top: 0, right: 0, bottom: 0 }; // buttons over the map

  constructor(
    private readonly fleet: Fleet,
    private readonly timeline: Timeline,
  ) {
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    timeline.onChange(this.redraw);
    this.connectPointers();
    find("#map-fit").addEventListener("click", () => {
      this.view.isFitting = true;
      this.redraw();
    });
    find("#map-in").addEventListener("click", () => this.zoom(1.5));
    find("#map-out").addEventListener("click", () => this.zoom(1 / 1.5));
    find("#map-clear").addEventListener("click", () => {
      for (const path of this.paths.values()) path.clear();
      this.redraw();
    });
    setInterval(() => this.describe(), DESCRIBE_MS);
    setInterval(() => this.age(), AGE_MS);
  }

  add(name: string, pose: Pose): void {
    const path = this.paths.get(name) ?? new Path();
    this.paths.set(name, path);
    path.add(pose, now_s());
    this.redraw();
  }

  /** Path from before the page was opened; it is drawn in front of the later path. */
  prepend(name: string, poses: PastPose[]): void {
    const path = new Path();
    for (const { pose, time_s } of [...poses, ...(this.paths.get(name)?.poses() ?? [])]) path.add(pose, time_s);
    this.paths.set(name, path);
    this.redraw();
  }

  show(selected: string | null): void {
    this.selected = selected;
    const names = new Set(this.fleet.robots.map(({ name }) => name));
    for (const name of this.paths.keys()) if (!names.has(name)) this.paths.delete(name); // forgotten by the daemon
    this.redraw();
  }

  /** Clear the path: the odometry has a new origin. */
  forget(name: string): void {
    this.paths.get(name)?.clear();
    this.redraw();
  }

  private zoom(factor: number): void {
    this.view.zoom(factor);
    this.redraw();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    this.view.width = Math.max(1, clientWidth);
    this.view.height = Math.max(1, clientHeight);
    const { offsetLeft: left, offsetTop: top, offsetWidth, offsetHeight } = find("#map .group");
    this.buttons = { left, top, right: left + offsetWidth, bottom: top + offsetHeight };
    this.canvas.width = Math.round(clientWidth * devicePixelRatio);
    this.canvas.height = Math.round(clientHeight * devicePixelRatio);
    this.redraw();
  }

  private connectPointers(): void {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this.view.pan(event.movementX, event.movementY);
      this.redraw();
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && document.body.dataset["shape"] === "phone") return; // one finger scrolls the page
        event.preventDefault();
        this.view.zoom(1.0015 ** -event.deltaY, event.offsetX, event.offsetY);
        this.redraw();
      },
      { passive: false },
    );
  }

  private *everything(): Generator<{ x: number; y: number }> {
    yield { x: 0, y: 0 };
    for (const path of this.paths.values()) {
      yield* path.corners;
      if (path.pose) yield { x: path.pose.x_m, y: path.pose.y_m };
    }
  }

  private draw(): void {
    const { context: c, view } = this;
    c.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    c.clearRect(0, 0, view.width, view.height);
    c.font = `11px ${getComputedStyle(this.canvas).fontFamily}`;
    this.drawGrid();
    this.layer.draw(c, view, this.paths, this.selected);
    this.drawRobots();
    this.drawScale();
  }

  private drawGrid(): void {
    const { context: c, view } = this;
    const [left, top] = view.toM(0, 0);
    const [right, bottom] = view.toM(view.width, view.height);
    const widest = Math.max(...[left, right].map((x) => c.measureText(digits(x, 0)).width));
    const step = roundUp(Math.max(GRID_PX, widest + LABEL_PX) / view.pxPerM);
    const places = step < 1 ? Math.max(1, Math.ceil(-Math.log10(step))) : 0;
    const labels: [text: string, x: number, y: number][] = [];
    c.lineWidth = 1;
    for (let index = Math.ceil(left / step); index * step <= right; index++) {
      const x = Math.round(view.toPx(index * step, 0)[0]) + 0.5;
      this.drawLine(x, 0, x, view.height, index === 0);
      labels.push([digits(index * step, places), x + 4, 5]);
    }
    for (let index = Math.ceil(bottom / step); index * step <= top; index++) {
      const y = Math.round(view.toPx(0, index * step)[1]) + 0.5;
      this.drawLine(0, y, view.width, y, index === 0);
      if (y > 24) labels.push([digits(index * step, places), 5, y + 4]);
    }
    for (const label of labels) this.drawLabel(...label);
  }

  /** Text over the lines, outlined in the ground's colour. */
  private drawLabel(text: string, x: number, y: number, variable = "muted"): void {
    const { context: c } = this;
    c.textBaseline = "top";
    c.lineWidth = 4;
    c.strokeStyle = colour("surface");
    c.fillStyle = colour(variable);
    c.strokeText(text, x, y);
    c.fillText(text, x, y);
  }

  private drawLine(x1: number, y1: number, x2: number, y2: number, isAxis: boolean): void {
    const { context: c } = this;
    c.strokeStyle = colour(isAxis ? "axis" : "grid");
    c.beginPath();
    c.moveTo(x1, y1);
    c.lineTo(x2, y2);
    c.stroke();
  }

  /** The chosen robot is drawn last and named first. Names that would overlap others are left out. */
  private drawRobots(): void {
    const { context: c, view, fleet } = this;
    const radius = Math.max(LEAST_BODY_PX, BODY_M * view.pxPerM);
    const shown = fleet.robots.flatMap((robot) => {
      const pose = this.poseOf(robot);
      if (!pose) return [];
      const [x, y] = view.toPx(pose.x_m, pose.y_m);
      return [{ robot, pose, x, y, state: fleet.state(robot), isSelected: robot.name === this.selected }];
    });
    shown.sort((one, other) => Number(one.isSelected) - Number(other.isSelected));
    for (const { robot, pose, x, y, state, isSelected } of shown) {
      const paint = robotPaint(robot.name);
      if (state === "connected" && this.timeline.cursor_s === null) drawGhost(c, view, pose, robot, radius, paint);
      drawRobot(c, { x, y, theta_rad: pose.theta_rad, radius, state, paint, isSelected });
    }
    if (shown.length < 2 && shown.every(({ state }) => state === "connected" || state === "locked")) return;
    const labels = shown.reverse().map(({ robot, x, y, state }) => {
      const texts = [robot.name + this.describeState(robot, state), robot.name];
      const sizes = texts.map((text) => ({ text, width: c.measureText(text).width, height: LABEL_PX }));
      return { x, y, state, radius: radius + 5, sizes };
    });
    for (const { label, text, left, top } of placeLabels(labels, view.width, view.height, [
      this.scale(),
      this.buttons,
    ])) {
      this.drawLabel(text, left, top, LABEL_COLOURS[label.state]);
    }
  }

  /** Pose of a robot now, or at the cursor's instant. */
  private poseOf(robot: RobotView): Pose | null {
    const path = this.paths.get(robot.name);
    const { cursor_s } = this.timeline;
    return (cursor_s === null ? path?.pose : path?.at(cursor_s)) ?? null;
  }

  private describeState(robot: RobotView, state: RobotState): string {
    if (state === "silent" || state === "unknown") return ` · ${ageText(this.fleet.age_s(robot))} old`;
    return state === "gone" ? " · no link" : "";
  }

  /** The scale: a round length with its text. */
  private scale(): Box & { length_m: number } {
    const { view } = this;
    const length_m = roundUp(SCALE_PX / view.pxPerM);
    const [right, bottom] = [view.width - 14.5, Math.round(view.height) - 14.5];
    return { length_m, left: right - length_m * view.pxPerM, right, top: bottom - SCALE_TEXT_PX, bottom };
  }

  private drawScale(): void {
    const { context: c } = this;
    const { length_m, left, right, bottom: y } = this.scale();
    c.strokeStyle = c.fillStyle = colour("text");
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(left, y - 5);
    c.lineTo(left, y);
    c.lineTo(right, y);
    c.lineTo(right, y - 5);
    c.stroke();
    c.textAlign = "center";
    c.textBaseline = "bottom";
    c.fillText(lengthText(length_m), (left + right) / 2, y - 4);
    c.textAlign = "start";
  }

  private age(): void {
    if (!this.fleet.isHeard || this.fleet.robots.some((robot) => this.fleet.isSilent(robot))) this.redraw();
  }

  /** For screen readers. */
  private describe(): void {
    const path = this.selected === null ? undefined : this.paths.get(this.selected);
    this.canvas.dataset.points = String(path?.points.length ?? 0);
    this.canvas.dataset.length = (path?.length_m ?? 0).toFixed(3);
    const where = path?.pose
      ? `${this.selected} at x ${path.pose.x_m.toFixed(2)} m, y ${path.pose.y_m.toFixed(2)} m, ` +
        `driven ${path.length_m.toFixed(1)} m on this page`
      : "no pose has arrived yet";
    this.canvas.setAttribute("aria-label", `Map: ${where}`);
  }
}
