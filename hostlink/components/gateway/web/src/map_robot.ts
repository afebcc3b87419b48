/** Draws one robot on the map: its body in its colour, its state, and its commanded velocity. */

import type { RobotState } from "./fleet";
import { colour } from "./theme";
import type { Pose, RobotView, Velocity } from "./views";
import type { Viewport } from "./viewport";

const GHOST_S = 1; // time ahead
const GHOST_STEPS = 16;
const LEAST_GHOST_PX = 4;

interface Drawn {
  x: number;
  y: number;
  theta_rad: number;
  radius: number;
  state: RobotState;
  paint: string;
  isSelected: boolean;
}

export function drawRobot(c: CanvasRenderingContext2D, robot: Drawn): void {
  const { radius, state, paint } = robot;
  const isGone = state === "gone";
  c.save();
  c.translate(robot.x, robot.y);
  ring(c, robot);
  c.rotate(-robot.theta_rad);
  c.fillStyle = isGone ? colour("surface") : paint;
  c.strokeStyle = isGone ? paint : colour("surface");
  c.lineWidth = 2;
  c.globalAlpha = state === "silent" || state === "unknown" ? 0.6 : 1;
  c.beginPath();
  c.arc(0, 0, radius, 0, 2 * Math.PI);
  c.fill();
  c.stroke();
  c.fillStyle = isGone ? paint : colour("surface");
  c.beginPath();
  c.moveTo(radius * 0.68, 0);
  c.lineTo(-radius * 0.38, radius * 0.5);
  c.lineTo(-radius * 0.14, 0);
  c.lineTo(-radius * 0.38, -radius * 0.5);
  c.closePath();
  c.fill();
  c.restore();
}

/** Amber: silent. Red: gone (dashed) or locked. */
function ring(c: CanvasRenderingContext2D, { radius, state, isSelected }: Drawn): void {
  const variables = { unknown: null, connected: null, silent: "warn", gone: "danger", locked: "danger" } as const;
  const variable = variables[state] ?? (isSelected ? "text" : null);
  if (variable === null) return;
  c.strokeStyle = colour(variable);
  c.lineWidth = variables[state] === null ? 1.5 : 3;
  c.setLineDash(state === "gone" ? [4, 3] : []);
  c.beginPath();
  c.arc(0, 0, radius + 4, 0, 2 * Math.PI);
  c.stroke();
  c.setLineDash([]);
}

/** Draw where the commanded velocity leads in one second (dashed, with an outline), and the measured velocity. */
export function drawGhost(
  c: CanvasRenderingContext2D,
  view: Viewport,
  pose: Pose,
  robot: RobotView,
  radius: number,
  paint: string,
): void {
  const asked = course(pose, robot.velocity);
  const end = asked.at(-1) ?? pose;
  const [[x0, y0], [x, y]] = [view.toPx(pose.x_m, pose.y_m), view.toPx(end.x_m, end.y_m)];
  const isTurn = Math.abs(robot.velocity.angular_rad_s) > 0.05;
  if (Math.hypot(x - x0, y - y0) < LEAST_GHOST_PX && !isTurn) return;
  c.save();
  c.strokeStyle = paint;
  c.lineWidth = 1.5;
  c.globalAlpha = 0.8;
  c.setLineDash([4, 4]);
  line(c, view, asked);
  c.beginPath();
  c.arc(x, y, radius, 0, 2 * Math.PI);
  c.moveTo(x, y);
  c.lineTo(x + radius * Math.cos(end.theta_rad), y - radius * Math.sin(end.theta_rad));
  c.stroke();
  c.setLineDash([]);
  c.lineWidth = 3;
  if (robot.odometry?.twist) line(c, view, course(pose, robot.odometry.twist));
  c.restore();
}

function line(c: CanvasRenderingContext2D, view: Viewport, poses: Pose[]): void {
  c.beginPath();
  poses.forEach((pose, index) => {
    const [x, y] = view.toPx(pose.x_m, pose.y_m);
    if (index === 0) c.moveTo(x, y);
    else c.lineTo(x, y);
  });
  c.stroke();
}

function course(from: Pose, { linear_m_s, linear_y_m_s = 0, angular_rad_s }: Velocity): Pose[] {
  const step_s = GHOST_S / GHOST_STEPS;
  const poses = [from];
  for (let at = from; poses.length <= GHOST_STEPS; poses.push(at)) {
    const middle_rad = at.theta_rad + (angular_rad_s * step_s) / 2;
    const [cos, sin] = [Math.cos(middle_rad), Math.sin(middle_rad)];
    at = {
      x_m: at.x_m + (linear_m_s * cos - linear_y_m_s * sin) * step_s,
      y_m: at.y_m + (linear_m_s * sin + linear_y_m_s * cos) * step_s,
      theta_rad: at.theta_rad + angular_rad_s * step_s,
    };
  }
  return poses;
}
