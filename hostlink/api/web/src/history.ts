/** What happened before the page was opened, from the daemon's black box: once for each robot, when it is first shown. */

import type { DeviceLog } from "./log";
import type { RobotMap } from "./map";
import type { PlotData, Plots } from "./plots";
import { ofRobot, rest } from "./rest";
import type { Pose, RobotView } from "./views";

interface Past<Message> {
  age_s: number;
  msg: Message;
}

interface PastEvent {
  kind: string;
  facts: Record<string, unknown>;
}

interface HistoryView {
  poses: { age_s: number; pose: Pose }[];
  plot_data: Past<PlotData>[];
  events: Past<PastEvent>[];
}

export class History {
  private readonly requested = new Set<string>();

  constructor(
    private readonly map: RobotMap,
    private readonly plots: Plots,
    private readonly log: DeviceLog,
    private readonly isShown: (name: string) => boolean,
  ) {}

  /** Robots are shown; those that are new here have a past. */
  show(robots: RobotView[]): void {
    for (const { name } of robots) {
      if (!this.requested.has(name)) {
        this.requested.add(name);
        void this.fetch(name);
      }
    }
  }

  private async fetch(name: string): Promise<void> {
    let past: HistoryView;
    try {
      past = await rest<HistoryView>("GET", ofRobot(name, "history"));
    } catch {
      return; // an older daemon, or the connection is gone: the page shows what comes
    }
    this.map.prepend(
      name,
      past.poses.map(({ pose }) => pose),
    );
    if (this.isShown(name)) this.plots.prepend(past.plot_data);
    this.log.prepend(past.events.map(({ age_s, msg }) => ({ age_s, robot: name, ...described(msg) })));
  }
}

/** An event as a line of the log; level as in rosgraph_msgs/Log. */
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
      return { level: 2, text: `stopped: ${reason} (${String(facts["owner"] ?? "")})` };
    case "gone":
      return { level: 4, text: facts["was_moving"] ? "gone while it was driven" : "gone" };
    case "diagnosed":
      return { level: 4, text: `${String(facts["cause"] ?? "")} ${String(facts["detail"] ?? "")}`.trim() };
    default:
      return { level: 1, text: kind.replace("_", " ") };
  }
}
