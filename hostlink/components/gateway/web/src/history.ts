/** History from before the page was opened, from the daemon's black box: one request for all robots. */

import type { DeviceLog } from "./log";
import type { RobotMap } from "./map";
import { type HistoriesView, type HistoryView, linesOf } from "./past";
import type { Plots } from "./plots";
import { ofRobot, rest } from "./rest";
import { now_s } from "./timeline";
import type { RobotView } from "./views";

const TIMEOUT_MS = 15_000; // minutes of a fleet, over a slow line

export class History {
  private readonly requested = new Set<string>();
  private readonly waiting: string[] = []; // requested one after the other, so that a stop is not delayed
  private isFetching = false;
  private hasFleet = false;
  private plotted = "";

  constructor(
    private readonly map: RobotMap,
    private readonly plots: Plots,
    private readonly log: DeviceLog,
  ) {}

  /** Load the history of these robots. All of the first call are one request; later ones have their own. `chosen`: robot with plots. */
  show(robots: RobotView[], chosen: string | undefined): void {
    const names = new Set(robots.map(({ name }) => name));
    for (const name of this.requested) if (!names.has(name)) this.requested.delete(name); // forgotten by the daemon
    if (!this.hasFleet && names.size > 0) {
      this.hasFleet = true;
      for (const name of names) this.requested.add(name);
      this.plotted = chosen ?? "";
      void this.fetchFleet();
      return;
    }
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
    void this.fetchWaiting();
  }

  private async fetchFleet(): Promise<void> {
    this.isFetching = true;
    const chosen = this.plotted;
    const path = `api/history?chosen=${encodeURIComponent(chosen)}`;
    const past = await rest<HistoriesView>("GET", path, undefined, TIMEOUT_MS).catch(() => null);
    for (const each of past?.robots ?? []) {
      if (this.requested.has(each.name)) this.prepend(each.name, each, each.name === chosen);
    }
    this.isFetching = false;
    await this.fetchWaiting();
  }

  private async fetchWaiting(): Promise<void> {
    if (this.isFetching) return;
    this.isFetching = true;
    for (let name = this.waiting.shift(); name !== undefined; name = this.waiting.shift()) {
      const past = this.requested.has(name) ? await request(name) : null;
      if (past !== null) this.prepend(name, past, true);
    }
    this.isFetching = false;
  }

  private prepend(name: string, past: HistoryView, hasPlots: boolean): void {
    const now = now_s();
    this.map.prepend(
      name,
      past.poses.map(({ pose, age_s }) => ({ pose, time_s: now - age_s })),
    );
    this.log.prepend(linesOf(past, name, now));
    if (hasPlots) this.plots.prepend(name, past);
  }

  private async fetchPlots(name: string): Promise<void> {
    const past = await request(name);
    if (past !== null) this.plots.prepend(name, past);
  }
}

/** Null for an older daemon or without a connection; the page then shows only new data. */
async function request(name: string): Promise<HistoryView | null> {
  return rest<HistoryView>("GET", ofRobot(name, "history"), undefined, TIMEOUT_MS).catch(() => null);
}
