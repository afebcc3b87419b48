/** The newest that the daemon has sent of its robots and links; and which robot is shown and driven. */

import { remember, remembered } from "./dom";
import type { LinkView, RobotView } from "./views";

export class Fleet {
  robots: RobotView[] = [];
  isKnown = false; // whether the daemon has sent its robots
  links: LinkView[] = [];

  private chosen = remembered("robot", "");

  constructor(private readonly onChange: () => void) {}

  /** The one that is shown: as chosen, else the first. */
  get robot(): RobotView | undefined {
    return this.robots.find((robot) => robot.name === this.chosen) ?? this.robots[0];
  }

  get link(): LinkView | undefined {
    const number = this.robot?.link;
    return this.links.find((link) => link.number === number);
  }

  choose(name: string): void {
    this.chosen = name;
    remember("robot", name);
    this.onChange();
  }
}
