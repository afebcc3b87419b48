/** The newest data about robots and links: the chosen robot, and which robots are silent. */

import { remember, remembered } from "./dom";
import { Pulse } from "./pulse";
import type { LinkView, RobotView } from "./views";

/** gone: not connected. silent: connected, but sends nothing. unknown: the daemon is not heard. */
export type RobotState = "unknown" | "gone" | "silent" | "locked" | "connected";

const CHECK_MS = 50;
const byName = new Intl.Collator("en", { numeric: true }); // robot_2 before robot_10

export class Fleet {
  /** Sorted by name, numbers by value. */
  robots: RobotView[] = [];
  isKnown = false; // whether the daemon has sent its robots
  isHeard = true; // whether the daemon is heard; otherwise the state of robots is unknown
  daemonHeardAt_ms = () => performance.now();
  links: LinkView[] = [];

  private shown = ""; // name of the chosen robot
  private readonly pulses = new Map<string, Pulse>(); // by robot and link: a robot that reconnects starts anew
  private silent = "";
  private known = new Set<string>(); // names in the last list that was not empty

  /** `onChange` is called when another robot is chosen, or a robot falls silent. */
  constructor(private readonly onChange: () => void) {
    setInterval(() => this.check(), CHECK_MS);
  }

  receive(robots: RobotView[]): void {
    if (robots.length > 0 && !robots.some(({ name }) => this.known.has(name))) this.begin(robots);
    if (robots.length > 0) this.known = new Set(robots.map(({ name }) => name));
    this.robots = [...robots].sort((one, other) => byName.compare(one.name, other.name));
    this.isKnown = true;
    const now = performance.now();
    for (const robot of robots) {
      const { odometry } = robot;
      const key = keyOf(robot);
      const pulse = this.pulses.get(key) ?? new Pulse(now);
      this.pulses.set(key, pulse);
      if (odometry) pulse.note(odometry.count, odometry.age_s, odometry.rate_hz, now);
      else if (robot.frames != null) pulse.note(robot.frames, 0, null, now);
    }
    const known = new Set(robots.map(keyOf));
    for (const key of this.pulses.keys()) if (!known.has(key)) this.pulses.delete(key);
  }

  /** The chosen robot. No other one replaces it by itself: the user may be about to drive or stop it. */
  get robot(): RobotView | undefined {
    return this.robots.find((robot) => robot.name === this.shown);
  }

  /** Name of the chosen robot if it is not listed any longer; null otherwise. */
  get missed(): string | null {
    return this.robot === undefined && this.robots.length > 0 ? this.shown : null;
  }

  get link(): LinkView | undefined {
    return this.linkOf(this.robot);
  }

  linkOf(robot: RobotView | undefined): LinkView | undefined {
    return this.links.find((link) => link.number === robot?.link);
  }

  /** The most severe finding about it. */
  state(robot: RobotView): RobotState {
    if (!this.isHeard) return "unknown";
    if (!robot.connected) return "gone";
    if (this.isSilent(robot)) return "silent";
    return robot.locked ? "locked" : "connected";
  }

  isSilent(robot: RobotView): boolean {
    if (!this.isHeard || !robot.connected) return false;
    return this.pulses.get(keyOf(robot))?.isSilent(performance.now(), this.daemonHeardAt_ms()) ?? false;
  }

  /** Age of its newest data, in seconds. */
  age_s(robot: RobotView): number {
    return (this.pulses.get(keyOf(robot))?.age_ms(performance.now()) ?? 0) / 1000;
  }

  choose(name: string): void {
    this.shown = name;
    remember("robot", name);
    this.onChange();
  }

  /** Choose the first robot: the one chosen on an earlier visit, otherwise the first in the list. */
  private begin(robots: RobotView[]): void {
    const names = robots.map(({ name }) => name).sort(byName.compare);
    const chosen = remembered("robot", "");
    this.shown = names.includes(chosen) ? chosen : (names[0] ?? "");
  }

  private check(): void {
    const silent = this.robots
      .filter((robot) => this.isSilent(robot))
      .map(({ name }) => name)
      .join("\n");
    if (silent === this.silent) return;
    this.silent = silent;
    this.onChange();
  }
}

function keyOf({ name, connected, link }: RobotView): string {
  return `${name} ${connected ? link : "gone"}`;
}
