/** What happened before the page was opened, from the daemon's black box: of each robot when it is first shown. */

import type { DeviceLog } from "./log";
import type { RobotMap } from "./map";
import { type HistoryView, linesOf } from "./past";
import type { Plots } from "./plots";
import { ofRobot, rest } from "./rest";
import { now_s } from "./timeline";
import type { RobotView } from "./views";

const TIMEOUT_MS = 15_000; // minutes of a robot, over a slow line

export class History {
  private readonly requested = new Set<string>();
  private readonly waiting: string[] = []; // requested one after the other: a stop finds the line free
  private isFetching = false;
  private plotted = "";

  constructor(
    private readonly map: RobotMap,
    private readonly plots: Plots,
    private readonly log: DeviceLog,
  ) {}

  /** Robots are shown; those that are new here have a past. `chosen`: whose plots are shown. */
  show(robots: RobotView[], chosen: string | undefined): void {
    const names = new Set(robots.map(({ name }) => name));
    for (const name of this.requested) if (!names.has(name)) this.requested.delete(name); // it is forgotten
    const isNew = chosen !== undefined && !this.requested.has(chosen);
    for (const name of isNew ? [chosen, ...names] : names) {
      if (this.requested.has(name)) continue;
      this.requested.add(name);
      this.waiting.push(name);
    }
    if (chosen !== undefined && chosen !== this.plotted) {
      this.plotted = chosen;
      if (!isNew) void this.fetchPlots(chosen);
    }
    void this.fetchAll();
  }

  private async fetchAll(): Promise<void> {
    if (this.isFetching) return;
    this.isFetching = true;
    for (let name = this.waiting.shift(); name !== undefined; name = this.waiting.shift()) {
      if (this.requested.has(name)) await this.fetch(name);
    }
    this.isFetching = false;
  }

  private async fetch(name: string): Promise<void> {
    const past = await request(name);
    if (past === null) return;
    const now = now_s();
    this.map.prepend(
      name,
      past.poses.map(({ pose, age_s }) => ({ pose, time_s: now - age_s })),
    );
    this.log.prepend(linesOf(past, name, now));
    this.plots.prepend(name, past);
  }

  private async fetchPlots(name: string): Promise<void> {
    const past = await request(name);
    if (past !== null) this.plots.prepend(name, past);
  }
}

/** Null: an older daemon, or the connection is gone; the page shows what comes. */
async function request(name: string): Promise<HistoryView | null> {
  return rest<HistoryView>("GET", ofRobot(name, "history"), undefined, TIMEOUT_MS).catch(() => null);
}
