/** The battery of each robot that has one, while a list shows them: docs/robot.md#what-the-robot-knows-of-itself. */

import type { Connection } from "./connection";
import type { Fleet } from "./fleet";
import { Followed } from "./followed";
import type { BatteryState } from "./health";

const MOST = 64; // robots; each is a subscription, of which the daemon allows 256

export class Batteries {
  private readonly followed = new Map<string, Followed<BatteryState>>();
  private readonly known = new Map<string, number | null>();

  constructor(
    private readonly fleet: Fleet,
    private readonly connection: Connection,
  ) {}

  /** In volts; null: not known. */
  volts(name: string): number | null {
    return this.known.get(name) ?? null;
  }

  /** What they were is not known to be so any more. */
  forget(): void {
    this.known.clear();
  }

  /** Follow those of all robots, or of none. */
  show(isShown: boolean): void {
    const robots = isShown ? this.fleet.robots.slice(0, MOST) : [];
    const names = new Set(robots.map(({ name }) => name));
    for (const [name, followed] of this.followed) {
      if (names.has(name)) continue;
      followed.end();
      this.followed.delete(name);
    }
    for (const robot of robots) {
      const followed = this.followed.get(robot.name) ?? this.follow(robot.name);
      followed.show(robot, this.fleet.linkOf(robot));
    }
  }

  private follow(name: string): Followed<BatteryState> {
    const followed = new Followed<BatteryState>(
      this.connection,
      "battery",
      "sensor_msgs/BatteryState",
      ({ voltage }) => this.known.set(name, voltage),
      () => this.known.delete(name),
    );
    this.followed.set(name, followed);
    return followed;
  }
}
