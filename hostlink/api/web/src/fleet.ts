/** The newest that the daemon has sent of its robots and links; which robot is shown and driven; who is silent. */

import { remember, remembered } from "./dom";
import { Pulse } from "./pulse";
import type { LinkView, RobotView } from "./views";

/** gone: not connected. silent: connected, but nothing comes. unknown: the daemon is not heard. */
export type RobotState = "unknown" | "gone" | "silent" | "locked" | "connected";

const CHECK_MS = 50;
const byName = new Intl.Collator("en", { numeric: true }); // robot_2 before robot_10

export class Fleet {
  /** In the order of their names, as a person counts. */
  robots: RobotView[] = [];
  isKnown = false; // whether the daemon has sent its robots
  isHeard = true; // the daemon is; else nobody knows which robot is silent
  daemonHeardAt_ms = () => performance.now();
  links: LinkView[] = [];

  private shown = ""; // the name of the one that is shown
  private readonly pulses = new Map<string, Pulse>(); // by robot and link: one that connects again begins anew
  private silent = "";
  private known = new Set<string>(); // the names of the last list that was not empty

  /** `onChange`: another robot is chosen, or one fell silent. */
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

  /** The one that is shown. No other takes its place by itself: somebody may be about to drive or to stop it. */
  get robot(): RobotView | undefined {
    return this.robots.find((robot) => robot.name === this.shown);
  }

  /** The name of the one that was shown and is not there any more; null: none is missed. */
  get missed(): string | null {
    return this.robot === undefined && this.robots.length > 0 ? this.shown : null;
  }

  get link(): LinkView | undefined {
    return this.linkOf(this.robot);
  }

  linkOf(robot: RobotView | undefined): LinkView | undefined {
    return this.links.find((link) => link.number === robot?.link);
  }

  /** The worst of what is wrong with it. */
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

  /** How old what is known of it is, in seconds. */
  age_s(robot: RobotView): number {
    return (this.pulses.get(keyOf(robot))?.age_ms(performance.now()) ?? 0) / 1000;
  }

  choose(name: string): void {
    this.shown = name;
    remember("robot", name);
    this.onChange();
  }

  /** Robots of which none was here before: the one that was chosen on an earlier visit, else the first. */
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
