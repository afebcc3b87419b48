/** The log panel: log lines of all devices and events of robots, filtered by level and words. */

import { find, make, setText } from "./dom";
import { LogList } from "./loglist";
import { makeField } from "./widgets";
import type { PastLine } from "./past";
import { now_s, type Timeline } from "./timeline";
import { offsetOf } from "./times";
import type { LogLine, RobotView } from "./views";

const [INFO, WARNING] = [2, 4];
const CHOICES: [level: string, label: string][] = [
  ["0", "all"],
  ["2", "info and worse"],
  ["4", "warnings and errors"],
  ["8", "errors"],
];

export class DeviceLog {
  private readonly lines: LogList;
  private readonly robots = new Map<string, { connected: boolean; locked: boolean }>(); // last known states

  constructor(timeline: Timeline) {
    this.lines = new LogList(timeline, "Log");
    const level = make("select", {}, ...CHOICES.map(([value, label]) => make("option", { value }, label)));
    const words = make("input", { type: "search", placeholder: "words", maxlength: "80" });
    const filter = () => this.lines.filter(Number(level.value), words.value);
    level.addEventListener("change", filter);
    words.addEventListener("input", filter);
    const controls = make("div", { class: "filters" }, makeField("Level", level), makeField("Filter", words));
    const hint = make("p", { class: "hint" }, "No log lines yet.");
    const zone = make("span", { class: "hint", "data-bar": "", title: "Local time of this computer" });
    setText(zone, `times at ${offsetOf(new Date())}`);
    find("#log").append(zone, controls, this.lines.box, hint);
  }

  add(line: LogLine): void {
    this.lines.add({ time_s: now_s(), level: line.level, robot: line.name, text: line.msg });
  }

  /** Log events of robots, which devices do not log themselves. */
  observe(robots: RobotView[]): void {
    for (const { name, connected, locked = false, lock_reason } of robots) {
      const before = this.robots.get(name);
      this.robots.set(name, { connected, locked });
      if (before === undefined) continue;
      if (locked && !before.locked) this.note(name, WARNING, `locked: ${lock_reason ?? ""}`);
      if (!locked && before.locked) this.note(name, INFO, "unlocked");
      if (connected !== before.connected)
        this.note(name, connected ? INFO : WARNING, connected ? "connected" : "link lost");
    }
  }

  private note(robot: string, level: number, text: string): void {
    this.lines.add({ time_s: now_s(), level, robot, text });
  }

  prepend(lines: PastLine[]): void {
    this.lines.prepend(lines);
  }
}
