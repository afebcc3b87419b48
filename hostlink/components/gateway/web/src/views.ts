/** The JSON of the daemon's REST API. Fields that an older daemon lacks are optional. */

import { digits } from "./dom";

export interface Pose {
  x_m: number;
  y_m: number;
  theta_rad: number;
}

export interface Velocity {
  linear_m_s: number;
  linear_y_m_s?: number; // to the left
  angular_rad_s: number;
}

/** Forward, and to the left if that is not 0. */
export function speedText(velocity: Velocity | undefined): string {
  const left = digits(velocity?.linear_y_m_s ?? 0, 2);
  const isStraight = left === digits(0, 2);
  return `${digits(velocity?.linear_m_s, 2)} m/s${isStraight ? "" : `, y ${left} m/s`}`;
}

/** What the robot's feedback does not tell is null. */
interface OdometryView {
  pose: Pose | null;
  twist: Velocity | null;
  is_moving?: boolean | null; // of a robot whose feedback tells only that
  age_s: number;
  rate_hz: number;
  count: number;
  restarts?: number;
}

/** What is known of its motion: its speed, or only whether it moves. Nothing that was not measured. */
export function motionText({ odometry, feedback }: RobotView): string {
  const isMoving = odometry?.is_moving ?? null;
  if (!odometry?.twist && isMoving !== null) return isMoving ? "moves" : "stands";
  if (!odometry?.twist && feedback === "none") return "no odometry";
  return speedText(odometry?.twist ?? undefined);
}

/** Whether its drive can move it sideways. A drive that is not configured takes every velocity. */
export function hasSideways({ kinematics }: RobotView): boolean {
  return ["", "planar", "mecanum", "omni3", "omni4"].includes(kinematics ?? "differential");
}

/** Whether its drive can turn it while it does not move forward. */
export function turnsInPlace({ kinematics }: RobotView): boolean {
  return kinematics !== "ackermann";
}

export interface RobotView {
  name: string;
  host?: string | null; // daemon that has its link; null: the daemon that sent this
  also_at?: string[]; // other daemons with a robot of this name
  connected: boolean;
  link: number | null;
  frames?: number | null; // number of frames that its device has sent on this link
  velocity_topic: string;
  command_type?: string; // type of velocity_topic
  feedback?: string; // what is known of its motion: pose, velocity, motion (whether it moves), none
  kinematics?: string; // its drive; empty: not configured
  odometry_topic: string | null; // null: its device publishes neither pose nor velocity
  played?: boolean; // its device is a recording, which cannot be driven
  holder: string | null;
  holder_address?: string | null;
  priority?: number | null;
  velocity: Velocity;
  odometry: OdometryView | null; // null: none has arrived; for ever without feedback
  locked?: boolean;
  lock_reason?: string | null;
  unreachable?: string | null; // why its device could not receive the last velocity
  battery_v?: number | null;
  battery_percent?: number | null;
  signal_dbm?: number | null; // WiFi signal of its device
  device_errors?: string[]; // codes of what `hostlink doctor` finds wrong, the most likely cause first
  firmware?: string | null; // name and version in its device's log
}

/** A robot after a stop, and its motion since, by odometry. */
export interface StoppedRobotView extends RobotView {
  standstill: {
    state: "stopped" | "moving" | "unknown";
    speed_m_s: number | null;
    turn_rad_s: number | null;
    reason: string;
  };
}

export interface TopicView {
  kind: string;
  name: string;
  type: string;
}

export interface LinkView {
  number: number;
  peer: string;
  protocol?: string;
  silent_s: number;
  topics: TopicView[];
  seconds: number;
  frames_from_device: number;
  frames_to_device: number;
  skipped_bytes: number;
  negotiations: number;
  replaced: number;
  rejected: Record<string, number>;
  clock?: { offset_s: number; drift_ppm: number; round_trip_s: number } | null;
  oldest_waiting_s?: number | null;
  signal_dbm?: number | null;
  diagnosis?: { code: string; cause: string; next_step: string }[];
}

export interface ClientView {
  name: string;
  kind: string;
  peer: string;
  role: string;
  program: string;
  seconds: number;
  lag_s: number;
  dropped: number;
}

/** A running recording. */
export interface RecordingView {
  name: string;
  owner: string;
  topics: string[];
  seconds: number;
  messages: number;
  dropped: number;
  bytes: number;
  failure?: string;
}

export interface IncidentView {
  robot: string;
  cause: string;
  detail: string;
  at: string;
  file: string; // empty until the half minute after it has passed
  bytes: number;
}

export interface IncidentCounts {
  pending: number;
  saved: number;
  missed: number;
}

/** The event `recordings`. */
export interface RecordingNews {
  recordings: RecordingView[];
  changes: number; // of the files
  incidents: IncidentCounts;
}

/** rosgraph_msgs/Log. */
export interface LogLine {
  header: { stamp: { secs: number } };
  level: number;
  name: string;
  msg: string;
}

/** GET api/drives */
export interface DriveView {
  robot: string;
  owner: string;
  address?: string;
  began: string;
  seconds: number;
  fastest_m_s: number;
  fastest_rad_s: number;
  end: string; // empty while it lasts
}

/** A driver with its address, as `client 3 (phone, 10.0.0.5)`. A name that has the address stays unchanged. */
export function named(owner: string, address: string | null | undefined): string {
  if (!address || owner.includes(address)) return owner;
  return owner.endsWith(")") ? `${owner.slice(0, -1)}, ${address})` : `${owner} (${address})`;
}

const REASONS: Record<string, string> = {
  "owner left": "its program disconnected",
  overruled: "a source of higher priority drove",
};

/** Why a drive ended, for people. */
export function reasonText(reason: string): string {
  return REASONS[reason] ?? reason;
}

/** A robot's topic of this leaf and type, on its link. */
export function topicOf(robot: RobotView, link: LinkView | undefined, leaf: string, type: string): string | null {
  const namespace = robot.velocity_topic.slice(0, robot.velocity_topic.lastIndexOf("/") + 1);
  const found = link?.topics.filter((topic) => topic.type === type && topic.name.split("/").at(-1) === leaf) ?? [];
  return (found.find((topic) => topic.name === namespace + leaf) ?? found[0])?.name ?? null;
}
