/** A robot's history from the daemon: its last minutes, or those around an incident. */

import { driverText } from "./clients";
import type { PlotData } from "./plots";
import type { Row } from "./series";
import { type Pose, reasonText, type Velocity } from "./views";

interface Past<Message> {
  age_s: number;
  msg: Message;
}

interface PastEvent {
  kind: string;
  facts: Record<string, unknown>;
}

/** GET api/robots/NAME/history; the oldest first. */
export interface HistoryView {
  poses: { age_s: number; pose: Pose; twist?: Velocity }[];
  commands?: { age_s: number; velocity: Velocity }[];
  plot_data: Past<PlotData>[];
  events: Past<PastEvent>[];
}

/** GET api/history: of every robot of the daemon. */
export interface HistoriesView {
  robots: (HistoryView & { name: string })[];
}

/** A log line; level as in rosgraph_msgs/Log. */
export interface PastLine {
  time_s: number;
  robot: string;
  level: number;
  text: string;
}

/** Commanded and measured velocity at the time of each pose: forward in m/s, then turn in rad/s. */
export function speedRows(past: HistoryView, zero_s: number): Row[] {
  const commands = past.commands ?? [];
  let next = 0;
  let asked: Velocity | null = null;
  return past.poses.map(({ age_s, twist }) => {
    for (let command = commands[next]; command && command.age_s >= age_s; command = commands[next]) {
      asked = command.velocity;
      next += 1;
    }
    const [forward, turn] = [asked?.linear_m_s ?? null, asked?.angular_rad_s ?? null];
    return [zero_s - age_s, forward, twist?.linear_m_s ?? null, turn, twist?.angular_rad_s ?? null];
  });
}

export function plotRows(past: HistoryView, zero_s: number): Row[] {
  return past.plot_data.map(({ age_s, msg }) => [zero_s - age_s, ...valuesOf(msg)]);
}

/** The robot's use of a Twist: set-point, measured speed and PWM of each wheel. */
export function valuesOf({ linear, angular }: PlotData): number[] {
  return [angular.x, linear.x, angular.y, linear.y, linear.z, angular.z];
}

export function linesOf(past: HistoryView, robot: string, zero_s: number): PastLine[] {
  return past.events.map(({ age_s, msg }) => ({ time_s: zero_s - age_s, robot, ...described(msg) }));
}

function described({ kind, facts }: PastEvent): { level: number; text: string } {
  const reason = String(facts["reason"] ?? "");
  switch (kind) {
    case "logged":
      return { level: 1 << Number(facts["level"] ?? 1), text: String(facts["text"] ?? "") };
    case "locked":
      return { level: 4, text: `locked: ${reason}` };
    case "unlocked":
      return { level: 2, text: "unlocked" };
    case "stopped":
      return { level: 2, text: `stopped: ${reasonText(reason)} (${driverText(String(facts["owner"] ?? ""), null)})` };
    case "gone":
      return { level: 4, text: facts["was_moving"] ? "link lost while it was driven" : "link lost" };
    case "diagnosed":
      return { level: 4, text: `${String(facts["cause"] ?? "")} ${String(facts["detail"] ?? "")}`.trim() };
    default:
      return { level: 1, text: kind.replace("_", " ") };
  }
}
