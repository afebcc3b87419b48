/** The path of a robot over time: a line that breaks where the odometry jumped, with bounded memory. */

import { boxAround } from "./viewport";
import type { Pose } from "./views";

const MAX_POINTS = 6000; // ten minutes at 10 Hz; above it every second point of the older half is removed
const STEP_M = 0.005;
const FARTHEST_M = 1e6; // as in the daemon: farther points are not drawn
const JUMP_M = 0.5; // a small robot does not move this far between two poses

export interface PastPose {
  pose: Pose;
  time_s: number;
}

export interface Point {
  x: number;
  y: number;
  theta_rad: number;
  time_s: number;
  isStart: boolean;
}

export class Path {
  pose: Pose | null = null;
  points: Point[] = [];
  length_m = 0;
  corners: { x: number; y: number }[] = []; // opposite corners of the bounding box
  version = 0; // changes when points were removed or replaced, not only added

  private time_s = 0; // of the last pose

  add(pose: Pose, time_s: number): void {
    if (!isPossible(pose)) return;
    this.pose = pose;
    this.time_s = time_s;
    const last = this.points.at(-1);
    const moved_m = last ? Math.hypot(pose.x_m - last.x, pose.y_m - last.y) : 0;
    if (last && moved_m < STEP_M) return;
    const isStart = !last || moved_m > JUMP_M;
    if (!isStart) this.length_m += moved_m;
    const point = { x: pose.x_m, y: pose.y_m, theta_rad: pose.theta_rad, time_s, isStart };
    this.points.push(point);
    const { left, right, bottom, top } = boxAround([...this.corners, point]);
    this.corners = [
      { x: left, y: bottom },
      { x: right, y: top },
    ];
    if (this.points.length > MAX_POINTS) this.thin();
  }

  /** Pose at that time, as far as it is kept; null: unknown. */
  at(time_s: number): Pose | null {
    if (this.pose && time_s >= this.time_s) return this.pose;
    for (let index = this.points.length - 1; index >= 0; index--) {
      const point = this.points[index];
      if (point && point.time_s <= time_s) return { x_m: point.x, y_m: point.y, theta_rad: point.theta_rad };
    }
    return null;
  }

  /** The poses of the path, as far as they are kept. */
  poses(): PastPose[] {
    const poses = this.points.map(({ x, y, theta_rad, time_s }) => ({ pose: { x_m: x, y_m: y, theta_rad }, time_s }));
    return this.pose ? [...poses, { pose: this.pose, time_s: this.time_s }] : poses;
  }

  clear(): void {
    this.points = [];
    this.corners = [];
    this.length_m = 0;
    this.version += 1;
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
    this.version += 1;
  }
}

function isPossible({ x_m, y_m, theta_rad }: Pose): boolean {
  return Math.abs(x_m) <= FARTHEST_M && Math.abs(y_m) <= FARTHEST_M && Number.isFinite(theta_rad);
}
