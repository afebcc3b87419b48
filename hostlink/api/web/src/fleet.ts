/** What the daemon knows of its robots and links, asked again and again over REST; and which robot is looked at. */

import { remember, remembered } from "./dom";
import { Refused, rest } from "./rest";
import type { LinkView, RobotView } from "./views";

const ROBOTS_MS = 300;
const LINKS_MS = 1000;

export class Fleet {
  robots: RobotView[] = [];
  links: LinkView[] = [];
  /** Null: not asked yet. */
  isReached: boolean | null = null;

  private chosen = remembered("robot", "");

  constructor(
    private readonly onChange: () => void,
    private readonly onRefusal: (refused: Refused) => void,
  ) {}

  start(): void {
    void this.repeat(ROBOTS_MS, async () => {
      this.robots = (await rest<{ robots: RobotView[] }>("GET", "api/robots")).robots;
      this.isReached = true;
    });
    void this.repeat(LINKS_MS, async () => {
      this.links = (await rest<{ links: LinkView[] }>("GET", "api/links")).links;
    });
  }

  /** The one that is looked at: as chosen, else the first. */
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

  private async repeat(interval_ms: number, ask: () => Promise<void>): Promise<never> {
    while (true) {
      try {
        await ask();
      } catch (error) {
        if (error instanceof Refused) this.onRefusal(error);
        else this.isReached = false;
      }
      this.onChange();
      await new Promise((resolve) => setTimeout(resolve, interval_ms));
    }
  }
}
