/** The paths of robots, on a canvas of their own: while the view stays, only new parts are drawn. */

import type { Path } from "./path";
import { robotColour, robotPaint } from "./robot_colours";
import { colour, computedColour } from "./theme";
import type { Viewport } from "./viewport";

const LEAST_PX = 1.2; // a shorter piece is drawn with the next one

interface Drawn {
  count: number; // number of drawn points
  version: number;
  x: number; // end of the line
  y: number;
}

export class PathLayer {
  private readonly canvas = document.createElement("canvas");
  private readonly context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private readonly drawn = new Map<Path, Drawn>();
  private view = "";

  /** Draw onto a canvas of the same size; the line of `selected` is thicker. */
  draw(target: CanvasRenderingContext2D, view: Viewport, paths: Map<string, Path>, selected: string | null): void {
    const { canvas } = this;
    const { width, height } = target.canvas;
    const present = [view.x_m, view.y_m, view.pxPerM, width, height, selected, colour("text")].join(" ");
    const known = new Set(paths.values());
    const isOther = [...this.drawn].some(([path, { version }]) => !known.has(path) || path.version !== version);
    if (present !== this.view || isOther) {
      this.view = present;
      this.drawn.clear();
      [canvas.width, canvas.height] = [width, height]; // this clears it
      this.context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
      this.context.lineJoin = this.context.lineCap = "round";
    }
    for (const [name, path] of paths) this.drawNew(name, path, view, name === selected);
    if (width > 0 && height > 0) target.drawImage(canvas, 0, 0, view.width, view.height);
  }

  /** Opaque, so that overlapping pieces of a line do not show. */
  private drawNew(name: string, path: Path, view: Viewport, isSelected: boolean): void {
    const { context: c } = this;
    const { points, version } = path;
    const drawn = this.drawn.get(path) ?? { count: 0, version, x: 0, y: 0 };
    this.drawn.set(path, drawn);
    if (drawn.count === points.length) return;
    c.strokeStyle = isSelected
      ? robotPaint(name)
      : computedColour(`color-mix(in oklab, ${robotColour(name)} 45%, var(--surface))`);
    c.lineWidth = isSelected ? 2.5 : 1.5;
    c.beginPath();
    c.moveTo(drawn.x, drawn.y);
    const [left, top] = [view.width / 2 - view.x_m * view.pxPerM, view.height / 2 + view.y_m * view.pxPerM];
    for (let index = drawn.count; index < points.length; index++) {
      const point = points[index];
      if (point === undefined) break;
      const [x, y] = [left + point.x * view.pxPerM, top - point.y * view.pxPerM];
      const isShort = Math.abs(x - drawn.x) < LEAST_PX && Math.abs(y - drawn.y) < LEAST_PX;
      if (point.isStart || index === 0) c.moveTo(x, y);
      else if (isShort && index < points.length - 1) continue;
      else c.lineTo(x, y);
      [drawn.x, drawn.y] = [x, y];
    }
    drawn.count = points.length;
    c.stroke();
  }
}
