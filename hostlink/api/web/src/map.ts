/** The map: a grid of round metres, the driven paths, the robots, and a scale. */

import { digits, find } from "./dom";
import { Path } from "./path";
import { colour } from "./theme";
import { boxAround, roundUp, Viewport } from "./viewport";
import type { Pose, RobotView } from "./views";

const GRID_PX = 56; // lines are not nearer than this
const BODY_M = 0.105; // half the paper's robot
const LEAST_BODY_PX = 9;
const SCALE_PX = 64;
const DESCRIBE_MS = 1000;

export class RobotMap {
  private readonly canvas = find<HTMLCanvasElement>("#map-canvas");
  private readonly context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private readonly view = new Viewport();
  private readonly paths = new Map<string, Path>();
  private readonly isCalm = matchMedia("(prefers-reduced-motion: reduce)");
  private robots: RobotView[] = [];
  private selected: string | null = null;
  private isScheduled = false;

  constructor() {
    new ResizeObserver(() => this.resize()).observe(this.canvas);
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
  }

  add(name: string, pose: Pose): void {
    const path = this.paths.get(name) ?? new Path();
    this.paths.set(name, path);
    path.add(pose);
    this.redraw();
  }

  /** Where it drove before this page knew it: in front of what the page has seen since. */
  prepend(name: string, poses: Pose[]): void {
    const path = new Path();
    for (const pose of [...poses, ...(this.paths.get(name)?.poses() ?? [])]) path.add(pose);
    this.paths.set(name, path);
    this.redraw();
  }

  show(robots: RobotView[], selected: string | null): void {
    this.robots = [...robots].sort((one, other) => Number(one.name === selected) - Number(other.name === selected));
    this.selected = selected;
    this.redraw();
  }

  /** Where the odometry starts anew, the old line means nothing. */
  forget(name: string): void {
    this.paths.get(name)?.clear();
    this.redraw();
  }

  redraw(): void {
    if (this.isScheduled) return;
    this.isScheduled = true;
    requestAnimationFrame(() => {
      this.isScheduled = false;
      if (this.view.isFitting && this.view.fit(boxAround(this.everything()), this.isCalm.matches)) this.redraw();
      this.draw();
    });
  }

  private zoom(factor: number): void {
    this.view.zoom(factor);
    this.redraw();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    this.view.width = Math.max(1, clientWidth);
    this.view.height = Math.max(1, clientHeight);
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
        if (!event.ctrlKey && document.documentElement.scrollHeight > innerHeight) return; // the page scrolls
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
      yield* path.points;
      if (path.pose) yield { x: path.pose.x_m, y: path.pose.y_m };
    }
  }

  private draw(): void {
    const { context: c, view } = this;
    c.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    c.clearRect(0, 0, view.width, view.height);
    c.font = `11px ${getComputedStyle(this.canvas).fontFamily}`;
    this.drawGrid();
    for (const [name, path] of this.paths) this.drawPath(path, name === this.selected);
    for (const robot of this.robots) this.drawRobot(robot);
    this.drawScale();
  }

  private drawGrid(): void {
    const { context: c, view } = this;
    const step = roundUp(GRID_PX / view.pxPerM);
    const places = step < 1 ? Math.max(1, Math.ceil(-Math.log10(step))) : 0;
    const [left, top] = view.toM(0, 0);
    const [right, bottom] = view.toM(view.width, view.height);
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

  /** Over the lines, with a border of the ground's colour. */
  private drawLabel(text: string, x: number, y: number): void {
    const { context: c } = this;
    c.textBaseline = "top";
    c.lineWidth = 4;
    c.strokeStyle = colour("surface");
    c.fillStyle = colour("muted");
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

  private drawPath(path: Path, isSelected: boolean): void {
    const { context: c, view } = this;
    c.strokeStyle = colour(isSelected ? "accent" : "muted");
    c.globalAlpha = isSelected ? 0.9 : 0.4;
    c.lineWidth = isSelected ? 2.5 : 1.5;
    c.lineJoin = c.lineCap = "round";
    c.beginPath();
    for (const point of path.points) {
      const [x, y] = view.toPx(point.x, point.y);
      if (point.isStart) c.moveTo(x, y);
      else c.lineTo(x, y);
    }
    c.stroke();
    c.globalAlpha = 1;
  }

  private drawRobot(robot: RobotView): void {
    const pose = this.paths.get(robot.name)?.pose;
    if (!pose) return;
    const { context: c, view } = this;
    const [x, y] = view.toPx(pose.x_m, pose.y_m);
    const radius = Math.max(LEAST_BODY_PX, BODY_M * view.pxPerM);
    const isSelected = robot.name === this.selected;
    c.save();
    c.translate(x, y);
    if (this.robots.length > 1) {
      c.textAlign = "center";
      this.drawLabel(robot.name, 0, radius + 6);
      c.textAlign = "start";
    }
    c.rotate(-pose.theta_rad);
    c.fillStyle = colour(isSelected && robot.connected ? "accent" : "muted");
    c.strokeStyle = colour("surface");
    c.lineWidth = 2;
    c.beginPath();
    c.arc(0, 0, radius, 0, 2 * Math.PI);
    c.fill();
    c.stroke();
    c.fillStyle = colour("surface");
    c.beginPath();
    c.moveTo(radius * 0.68, 0);
    c.lineTo(-radius * 0.38, radius * 0.5);
    c.lineTo(-radius * 0.14, 0);
    c.lineTo(-radius * 0.38, -radius * 0.5);
    c.closePath();
    c.fill();
    c.restore();
  }

  private drawScale(): void {
    const { context: c, view } = this;
    const length_m = roundUp(SCALE_PX / view.pxPerM);
    const length = length_m * view.pxPerM;
    const [right, y] = [view.width - 14.5, Math.round(view.height) - 14.5];
    c.strokeStyle = c.fillStyle = colour("text");
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(right - length, y - 5);
    c.lineTo(right - length, y);
    c.lineTo(right, y);
    c.lineTo(right, y - 5);
    c.stroke();
    c.textAlign = "center";
    c.textBaseline = "bottom";
    c.fillText(length_m < 1 ? `${Math.round(length_m * 100)} cm` : `${length_m} m`, right - length / 2, y - 4);
    c.textAlign = "start";
  }

  /** For screen readers. */
  private describe(): void {
    const path = this.selected === null ? undefined : this.paths.get(this.selected);
    this.canvas.dataset.points = String(path?.points.length ?? 0);
    this.canvas.dataset.length = (path?.length_m ?? 0).toFixed(3);
    const where = path?.pose
      ? `${this.selected} at x ${path.pose.x_m.toFixed(2)} m, y ${path.pose.y_m.toFixed(2)} m, ` +
        `driven ${path.length_m.toFixed(1)} m on this page`
      : "no pose has come yet";
    this.canvas.setAttribute("aria-label", `Map: ${where}`);
  }
}
