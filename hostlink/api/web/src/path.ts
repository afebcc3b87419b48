/** Where a robot drove: a line that breaks where the odometry jumped, as long as the memory given to it. */

import type { Pose } from "./views";

const MAX_POINTS = 6000; // ten minutes at 10 Hz; then every second one of the older half goes
const STEP_M = 0.005;
const JUMP_M = 0.5; // between two poses no small robot goes so far

export interface Point {
  x: number;
  y: number;
  isStart: boolean;
}

export class Path {
  pose: Pose | null = null;
  points: Point[] = [];
  length_m = 0;

  add(pose: Pose): void {
    this.pose = pose;
    const last = this.points.at(-1);
    const moved_m = last ? Math.hypot(pose.x_m - last.x, pose.y_m - last.y) : 0;
    if (last && moved_m < STEP_M) return;
    const isStart = !last || moved_m > JUMP_M;
    if (!isStart) this.length_m += moved_m;
    this.points.push({ x: pose.x_m, y: pose.y_m, isStart });
    if (this.points.length > MAX_POINTS) this.thin();
  }

  /** What it was made of, as far as it is drawn. */
  poses(): Pose[] {
    const poses = this.points.map(({ x, y }) => ({ x_m: x, y_m: y, theta_rad: 0 }));
    return this.pose ? [...poses, this.pose] : poses;
  }

  clear(): void {
    this.points = [];
    this.length_m = 0;
  }

  private thin(): void {
    const { points } = this;
    const kept: Point[] = [];
    points.forEach((point, index) => {
      const next = points[index + 1];
      if (index >= MAX_POINTS / 2 || index % 2 === 0) kept.push(point);
      else if (point.isStart && next) next.isStart = true;
    });
    this.points = kept;
  }
}
