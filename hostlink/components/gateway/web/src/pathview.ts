/** The path of a recording on a canvas: before and after the incident, and the pose at the cursor. */

import { digits, make } from "./dom";
import { Path, type PastPose, type Point } from "./path";
import { onceAFrame } from "./redraw";
import { colour } from "./theme";
import type { Timeline } from "./timeline";
import { boxAround, lengthText, roundUp, Viewport } from "./viewport";

const SCALE_PX = 64;
const BODY_PX = 10;
const MARK_PX = 6;

export class PathView {
  readonly canvas = make("canvas", { class: "path", role: "img" });
  readonly redraw = onceAFrame(() => this.canvas.isConnected && this.draw());

  private readonly context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private readonly view = new Viewport();
  private readonly path = new Path();

  /** `isIncident`: the timeline's zero is an incident, and not the beginning of a recording. */
  constructor(
    private readonly timeline: Timeline,
    poses: PastPose[],
    private readonly isIncident: boolean,
  ) {
    for (const { pose, time_s } of poses) this.path.add(pose, time_s);
    this.canvas.setAttribute(
      "aria-label",
      poses.length > 0 ? `Path, ${digits(this.path.length_m, 2)} m driven` : "Path: no pose was recorded",
    );
    this.canvas.dataset.points = String(this.path.points.length);
    this.connectPointer();
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    timeline.onChange(this.redraw);
  }

  zoom(factor: number): void {
    this.view.zoom(factor);
    this.redraw();
  }

  fit(): void {
    this.view.isFitting = true;
    this.redraw();
  }

  private resize(): void {
    const { canvas, view } = this;
    view.width = Math.max(1, canvas.clientWidth);
    view.height = Math.max(1, canvas.clientHeight);
    canvas.width = Math.round(view.width * devicePixelRatio);
    canvas.height = Math.round(view.height * devicePixelRatio);
    this.redraw();
  }

  private connectPointer(): void {
    const { canvas, view } = this;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      view.pan(event.movementX, event.movementY);
      this.redraw();
    });
  }

  private draw(): void {
    const { context: c, view, timeline, path } = this;
    const [begin, end] = timeline.range;
    const inRange = path.points.filter(({ time_s }) => time_s >= begin && time_s <= end);
    if (view.isFitting) view.fit(boxAround(inRange.length > 0 ? inRange : path.points), true);
    c.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    c.clearRect(0, 0, view.width, view.height);
    const zero_s = this.isIncident ? (timeline.zero_s ?? 0) : end;
    this.drawLine(path.points, "axis", 1.5);
    const isBefore = ({ time_s }: Point) => time_s <= zero_s;
    this.drawLine(inRange.filter(isBefore), "accent", 3);
    this.drawLine(
      inRange.filter(({ time_s }) => time_s >= zero_s),
      "second",
      3,
    );
    if (this.isIncident) this.drawIncident(zero_s);
    this.drawRobot(timeline.cursor_s ?? Math.min(end, zero_s));
    this.drawScale();
  }

  private drawLine(points: Point[], name: string, width: number): void {
    const { context: c, view } = this;
    c.strokeStyle = colour(name);
    c.lineWidth = width;
    c.lineJoin = c.lineCap = "round";
    c.beginPath();
    points.forEach((point, index) => {
      const [x, y] = view.toPx(point.x, point.y);
      if (point.isStart || index === 0) c.moveTo(x, y);
      else c.lineTo(x, y);
    });
    c.stroke();
  }

  private drawIncident(zero_s: number): void {
    const pose = this.path.at(zero_s);
    if (!pose) return;
    const { context: c } = this;
    const [x, y] = this.view.toPx(pose.x_m, pose.y_m);
    c.strokeStyle = colour("danger-text");
    c.lineWidth = 3;
    c.beginPath();
    for (const side of [-1, 1]) {
      c.moveTo(x - MARK_PX, y - side * MARK_PX);
      c.lineTo(x + MARK_PX, y + side * MARK_PX);
    }
    c.stroke();
  }

  private drawRobot(time_s: number): void {
    const pose = this.path.at(time_s);
    if (!pose) return;
    const { context: c } = this;
    const [x, y] = this.view.toPx(pose.x_m, pose.y_m);
    c.save();
    c.translate(x, y);
    c.rotate(-pose.theta_rad);
    c.strokeStyle = colour("text");
    c.lineWidth = 2;
    c.beginPath();
    c.arc(0, 0, BODY_PX, 0, 2 * Math.PI);
    c.moveTo(0, 0);
    c.lineTo(BODY_PX, 0);
    c.stroke();
    c.restore();
  }

  private drawScale(): void {
    const { context: c, view } = this;
    const length_m = roundUp(SCALE_PX / view.pxPerM);
    const [right, y] = [view.width - 14.5, view.height - 14.5];
    c.strokeStyle = c.fillStyle = colour("text");
    c.font = `11px ${getComputedStyle(this.canvas).fontFamily}`;
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(right - length_m * view.pxPerM, y);
    c.lineTo(right, y);
    c.stroke();
    c.textAlign = "right";
    c.fillText(lengthText(length_m), right, y - 6);
  }
}
