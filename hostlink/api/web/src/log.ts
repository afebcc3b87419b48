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
    const level = LEVELS[line.level] ?? "info";
    const time = new Date(line.header.stamp.secs * 1000).toLocaleTimeString([], { hour12: false });
    list.append(
      make(
        "li",
        { class: level, title: line.name },
        make("time", {}, time),
        make("b", {}, level),
        make("span", {}, line.msg),
      ),
    );
    while (list.childElementCount > MAX_LINES) list.firstElementChild?.remove();
    if (isAtEnd) box.scrollTop = box.scrollHeight;
  }
}
