/** The devices' log lines, the newest last. */

import { find, make } from "./dom";
import type { LogLine } from "./views";

const MAX_LINES = 200;
const LEVELS: Record<number, string> = { 1: "debug", 2: "info", 4: "warn", 8: "error", 16: "fatal" };

export class DeviceLog {
  private readonly box = find("#log [role=log]");
  private readonly list = find("#log ol");

  add(line: LogLine): void {
    const { box, list } = this;
    const isAtEnd = box.scrollHeight - box.scrollTop - box.clientHeight < 8;
    list.append(item(line.header.stamp.secs * 1000, line.level, line.name, line.msg));
    while (list.childElementCount > MAX_LINES) list.firstElementChild?.remove();
    if (isAtEnd) box.scrollTop = box.scrollHeight;
  }

  /** What happened before the page was opened, the oldest first. */
  prepend(past: { age_s: number; robot: string; level: number; text: string }[]): void {
    const now = Date.now();
    const room = Math.max(0, MAX_LINES - this.list.childElementCount);
    const items = past.slice(-room || past.length).map(({ age_s, robot, level, text }) => {
      const made = item(now - age_s * 1000, level, robot, text);
      made.classList.add("past");
      return made;
    });
    this.list.prepend(...items);
    this.box.scrollTop = this.box.scrollHeight;
  }
}

function item(at_ms: number, level: number, who: string, text: string): HTMLLIElement {
  const name = LEVELS[level] ?? "info";
  const time = new Date(at_ms).toLocaleTimeString([], { hour12: false });
  return make("li", { class: name, title: who }, make("time", {}, time), make("b", {}, name), make("span", {}, text));
}
