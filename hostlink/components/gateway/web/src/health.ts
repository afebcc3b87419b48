/** The link panel: quality of the connections to the chosen robot and to this page. */

import { ageText, digits, find, make, setText } from "./dom";
import type { Fleet } from "./fleet";
import type { LinkView, RobotView } from "./views";
import { bytes } from "./widgets";

type Tile = "rate" | "age" | "lost" | "resyncs" | "page" | "device" | "signal" | "battery" | "errors";

const TILES: Record<Tile, [label: string, hint: string]> = {
  rate: ["Odometry", "messages a second that tell its motion"],
  age: ["Last byte", "time since the device's last byte"],
  lost: ["Skipped", "bytes from the device that were not part of a valid frame"],
  resyncs: ["Resyncs", "how often the device announced its topics again"],
  page: ["RTT host", "round trip from this page to hostlink"],
  device: ["RTT device", "round trip from hostlink to the device"],
  signal: ["WiFi", "signal strength of the device's WiFi"],
  battery: ["Battery", "voltage of the robot's battery, and its charge if measured"],
  errors: [
    "Errors",
    "errors that the device reports; docs/robot.md#what-the-robot-knows-of-itself explains the numbers",
  ],
};
const OLD_S = 1;
const SLOW_MS = 200;
const WEAK_DBM = -80;
const USUAL_PROTOCOL = "rosserial"; // not said

/** docs/robot.md#what-the-robot-knows-of-itself */
const ERRORS: Record<number, string> = {
  11: "left wheel stalled",
  12: "right wheel stalled",
  21: "left wheel runs away",
  22: "right wheel runs away",
  31: "no command for 0.5 s",
  32: "started by its watchdog",
  33: "invalid velocity received",
  34: "gains or parameter refused",
  41: "bytes lost from the host",
  42: "unexpected frames",
  43: "messages not sent",
  51: "battery low",
};
const BATTERY_LOW = 51;
const MAX_ERRORS = 6; // errors shown

export class Health {
  private readonly values = new Map<Tile, HTMLElement>();
  private isBatteryLow = false;

  constructor() {
    for (const [tile, [label, hint]] of Object.entries(TILES)) {
      const value = make("dd", {}, "–");
      find("#link dl").append(make("div", { title: hint, "data-tile": tile }, make("dt", {}, label), value));
      this.values.set(tile as Tile, value);
    }
  }

  /**
   * Without a chosen robot all links are searched for the reason. While the robot is silent or the daemon is not heard,
   * counters are shown as old, the age grows, and changing values are unknown.
   */
  show(fleet: Fleet, roundTripMs: number | null): void {
    const { robot, link, links } = fleet;
    const isOld = robot !== undefined && (!fleet.isHeard || fleet.isSilent(robot));
    const isKnown = fleet.isHeard && !isOld;
    find("#link dl").classList.toggle("stale", isOld);
    const known_s = isOld ? fleet.age_s(robot) : (robot?.odometry?.age_s ?? link?.silent_s);
    const age_s = robot?.connected ? known_s : undefined;
    const device_s = isKnown ? link?.clock?.round_trip_s : undefined;
    const rate = robot?.feedback === "none" ? "none" : `${digits(robot?.odometry?.rate_hz, 1)} Hz`;
    this.set("rate", isKnown && robot?.connected ? rate : "–");
    this.set("age", age_s === undefined ? "–" : ageText(age_s), isOld || (age_s ?? 0) > OLD_S);
    this.set("lost", link ? bytes(link.skipped_bytes) : "–", (link?.skipped_bytes ?? 0) > 0);
    this.set("resyncs", link ? String(Math.max(0, link.negotiations - 1)) : "–", (link?.negotiations ?? 0) > 1);
    this.set(
      "page",
      roundTripMs === null ? "–" : `${digits(roundTripMs, roundTripMs < 10 ? 1 : 0)} ms`,
      (roundTripMs ?? 0) > SLOW_MS,
    );
    const dbm = (isKnown && robot?.signal_dbm) || null;
    this.set("signal", dbm === null ? "–" : `${digits(dbm, 0)} dBm`, dbm !== null && dbm < WEAK_DBM);
    this.set("battery", (isKnown && robot && batteryText(robot)) || "–", this.isBatteryLow);
    const firmware = find("#link .firmware");
    const protocol = link?.protocol === USUAL_PROTOCOL ? "" : (link?.protocol ?? "");
    const facts = [protocol, robot?.firmware ? `Firmware ${robot.firmware}` : ""].filter(Boolean).join(" · ");
    firmware.hidden = !facts;
    setText(firmware, facts);
    this.set("device", device_s === undefined ? "–" : `${digits(device_s * 1000, 0)} ms`);
    this.diagnose(robot === undefined ? links : link ? [link] : []);
  }

  /** null: the robot does not publish errors. */
  setErrors(numbers: number[] | null): void {
    const texts = numbers?.slice(0, MAX_ERRORS).map((number) => `${number} ${ERRORS[number] ?? "unknown"}`) ?? [];
    if (numbers && numbers.length > MAX_ERRORS) texts.push(`and ${numbers.length - MAX_ERRORS} more`);
    this.set("errors", numbers === null ? "–" : texts.join(", ") || "none", texts.length > 0);
    this.isBatteryLow = numbers?.includes(BATTERY_LOW) ?? false;
    this.values.get("battery")?.classList.toggle("bad", this.isBatteryLow);
  }

  private set(tile: Tile, text: string, isBad = false): void {
    const value = this.values.get(tile);
    if (value === undefined) return;
    setText(value, text);
    value.classList.toggle("bad", isBad);
  }

  private diagnose(links: LinkView[]): void {
    const list = find("#link .diagnosis");
    const lines = links.flatMap((link) =>
      (link.diagnosis ?? []).map(
        ({ cause, next_step }) => `${link.peer}: ${cause}${cause.endsWith(".") ? "" : ":"} ${next_step}`,
      ),
    );
    if (lines.join("\n") === list.dataset.shown) return;
    list.dataset.shown = lines.join("\n");
    list.replaceChildren(...lines.map((line) => make("li", {}, line)));
  }
}

/** Battery as a text; empty if the device measures neither voltage nor charge. */
export function batteryText(robot: RobotView): string {
  const { battery_v: volts, battery_percent: percent } = robot;
  const texts = [volts == null ? "" : `${digits(volts, 1)} V`, percent == null ? "" : `${digits(percent, 0)} %`];
  return texts.filter(Boolean).join(" ");
}
