/** The list of robots and their state, trouble first; one of them is chosen. */

import "./style/names.css";
import "./style/robots.css";
import { ageText, arrange, digits, find, make, setText } from "./dom";
import type { Fleet } from "./fleet";
import { FleetOrder, type Kind, KINDS } from "./fleetorder";
import { batteryText } from "./health";
import { commonPrefix, showName } from "./names";
import { robotColour } from "./robot_colours";
import { onPress } from "./press";
import { motionText, type RobotView } from "./views";

const FILTERED = 8; // with more robots a filter is shown
const TWIST = "geometry_msgs/Twist";
const LEAST_SPEED_M_S = 0.2; // speed of a full bar, at least

const COUNTED: Record<Kind, [label: string, hint: string]> = {
  gone: ["not connected", "Robots whose device is not connected"],
  silent: ["silent", "Robots that are connected and send nothing"],
  locked: ["locked", "Robots that obey no command until they are unlocked"],
  driving: ["driven", "Robots that a source drives"],
  connected: ["idle", "Robots that are connected, without a driver"],
};

/** Of the columns in the layout Fleet; the dot and the stop have none. The style sheet puts them above the rows. */
const BATTERY = "Battery"; // shown while a robot measures it
const HEADS = ["Robot", "State", "Speed", BATTERY, "Poses, WiFi"];

interface Card {
  row: HTMLElement;
  input: HTMLInputElement;
  name: HTMLElement;
  state: HTMLElement;
  speed: HTMLElement;
  battery: HTMLElement;
  signal: HTMLElement;
  stop: HTMLButtonElement;
  share: string; // of the bar of the speed, -1 to 1
}

export class RobotList {
  private readonly list = find("#robots .list");
  private readonly filter = find<HTMLInputElement>("#robots-filter");
  private readonly cards = new Map<string, Card>();
  private readonly counts = new Map<Kind, HTMLButtonElement>();
  private readonly placing = new FleetOrder();
  private only: Kind | null = null; // robots of this kind are shown, where their count is; null: all
  private readonly heads = make("div", { class: "heads", "aria-hidden": "true" });
  private order = "";
  private prefix = "";
  private shown = ""; // the chosen robot and the order of the list

  constructor(
    private readonly fleet: Fleet,
    private readonly driver: (robot: RobotView) => string | null,
    private readonly stop: (name: string) => void,
  ) {
    this.filter.addEventListener("input", () => this.show(true));
    for (const kind of KINDS) this.addCount(kind);
    this.heads.append(...HEADS.map(() => make("span")));
    for (const event of ["pointermove", "pointerdown", "wheel", "touchmove", "keydown"])
      this.list.addEventListener(event, () => this.placing.hold(performance.now()), { passive: true });
  }

  /** `isHeard`: whether the daemon is heard; otherwise a missing robot is not reported. */
  show(isHeard: boolean | null): void {
    const { robots, robot: chosen } = this.fleet;
    find("#robots .empty").hidden = robots.length > 0 || !isHeard;
    find("#robots-all").hidden = robots.length < 2;
    this.filter.hidden = robots.length <= FILTERED;
    this.place(robots);
    this.count(robots);
    const only = !isStrip() && this.only !== null && this.counts.get(this.only)?.checkVisibility() ? this.only : null;
    const words = !this.filter.checkVisibility() ? [] : this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const fastest = robots.map(({ odometry }) => Math.abs(odometry?.twist?.linear_m_s ?? 0));
    const full_m_s = Math.max(LEAST_SPEED_M_S, ...fastest);
    const hasBattery = robots.some((robot) => batteryText(robot) !== "");
    HEADS.forEach((head, index) => {
      const cell = this.heads.children[index];
      if (cell instanceof HTMLElement) setText(cell, head === BATTERY && !hasBattery ? "" : head);
    });
    let shown = 0;
    for (const robot of robots) {
      const card = this.cards.get(robot.name);
      if (card === undefined) continue;
      const what = this.describe(robot);
      const isOfKind = only === null || only === this.placing.kindOf(robot.name);
      const isMatch = isOfKind && words.every((word) => `${robot.name} ${what}`.toLowerCase().includes(word));
      card.row.hidden = !isMatch;
      shown += Number(isMatch);
      card.input.checked = robot === chosen;
      card.stop.tabIndex = robot === chosen ? 0 : -1;
      this.fill(card, robot, what, full_m_s);
    }
    this.reveal(chosen?.name ?? "");
    find("#robots .none").hidden = shown > 0 || robots.length === 0;
  }

  /** Scroll to the chosen robot once, so that the user can scroll on. In the layout Fleet, the user reads the list. */
  private reveal(name: string): void {
    const { robots, layout } = document.body.dataset;
    const order = layout === "Fleet" ? this.cards.size : this.order;
    const key = `${name} ${robots} ${order}`;
    if (key === this.shown) return;
    this.shown = key;
    this.cards.get(name)?.row.scrollIntoView({ block: "nearest", inline: "nearest" });
  }

  private kindOf(robot: RobotView): Kind {
    const state = this.fleet.state(robot);
    return (state === "connected" || state === "unknown") && this.driver(robot) !== null
      ? "driving"
      : state === "unknown"
        ? "connected"
        : state;
  }

  private fill(card: Card, robot: RobotView, what: string, full_m_s: number): void {
    const { fleet } = this;
    const state = fleet.state(robot);
    const isKnown = state !== "unknown"; // an old state is not enough to drive by
    card.row.dataset.state = isKnown ? this.kindOf(robot) : state;
    card.row.classList.toggle("faulty", isKnown && faultOf(robot) !== "");
    const title = `${robot.name}: ${what}`;
    if (card.row.title !== title) card.row.title = title;
    showName(card.name, robot.name, this.prefix);
    setText(card.state, what);
    const twist = isKnown && robot.connected ? robot.odometry?.twist : undefined;
    setText(card.speed, isKnown && robot.connected ? motionText(robot).replace(", ", "\n") : "");
    const share = Math.max(-1, Math.min(1, (twist?.linear_m_s ?? 0) / full_m_s)).toFixed(2);
    if (card.share !== share) card.speed.style.setProperty("--share", share);
    card.share = share;
    setText(card.battery, (isKnown && batteryText(robot)) || "");
    const dbm = (isKnown && robot.signal_dbm) || null;
    const rate = isKnown && robot.connected && robot.odometry ? `${digits(robot.odometry.rate_hz, 0)} Hz` : "";
    setText(card.signal, [rate, dbm === null ? "" : `${digits(dbm, 0)} dBm`].filter(Boolean).join(" "));
  }

  /** Put the cards in their order. Forgotten robots are removed. While the daemon is not heard, nothing moves. */
  private place(robots: RobotView[]): void {
    const names = robots.map(({ name }) => name);
    const known = new Set(names);
    if (!this.fleet.isHeard && names.every((name) => this.cards.has(name)) && known.size === this.cards.size) return;
    const placed = robots.map((robot) => {
      return { name: robot.name, kind: this.kindOf(robot), isFaulty: faultOf(robot) !== "" };
    });
    const ordered = this.placing.update(placed, performance.now());
    const order = ordered.join("\n");
    if (order === this.order) return;
    this.order = order;
    this.prefix = commonPrefix(names);
    for (const name of this.cards.keys()) if (!known.has(name)) this.cards.delete(name);
    for (const name of names) if (!this.cards.has(name)) this.make(name); // colours are given by name
    const focused = document.activeElement;
    arrange(this.list, [
      ...ordered.flatMap((name) => this.cards.get(name)?.row ?? []),
      ...(names.length > 0 ? [this.heads] : []),
    ]);
    if (focused instanceof HTMLElement && this.list.contains(focused) && document.activeElement !== focused)
      focused.focus({ preventScroll: true }); // an element that is moved loses the focus
  }

  /** Robots of each kind; a press shows only these. */
  private count(robots: RobotView[]): void {
    const numbers = new Map<Kind, number>();
    if (this.fleet.isHeard) {
      for (const robot of robots) {
        const kind = this.kindOf(robot);
        numbers.set(kind, (numbers.get(kind) ?? 0) + 1);
      }
    }
    if (robots.length < 2) this.only = null;
    find("#robots-counts").hidden = robots.length < 2;
    for (const [kind, button] of this.counts) {
      const number = numbers.get(kind) ?? 0;
      button.hidden = number === 0 && kind !== this.only;
      button.setAttribute("aria-pressed", String(kind === this.only && !isStrip()));
      setText(button, `${number} ${COUNTED[kind][0]}`);
    }
  }

  private addCount(kind: Kind): void {
    const button = make("button", { type: "button", "data-kind": kind, title: COUNTED[kind][1], hidden: "" });
    button.addEventListener("click", () => {
      if (isStrip()) {
        const first = this.list.querySelector(`.robot[data-state=${kind}]`);
        first?.scrollIntoView({ block: "nearest", inline: "start" });
        return;
      }
      this.only = this.only === kind ? null : kind;
      this.show(true);
    });
    this.counts.set(kind, button);
    find("#robots-counts").append(button);
  }

  private describe(robot: RobotView): string {
    const host = robot.host ? ` · at ${robot.host}` : "";
    const others = robot.also_at?.length ? ` · same name at ${robot.also_at.join(", ")}` : "";
    const fault = this.fleet.state(robot) === "connected" ? faultOf(robot) : "";
    return `${fault && `${fault} · `}${this.describeDriver(robot)}${describeAbilities(robot)}${host}${others}`;
  }

  private describeDriver(robot: RobotView): string {
    const state = this.fleet.state(robot);
    if (state === "unknown") return `heard ${ageText(this.fleet.age_s(robot))} ago`;
    if (state === "gone") return "not connected";
    if (state === "silent") return `silent ${ageText(this.fleet.age_s(robot))}`;
    if (state === "locked") return robot.lock_reason ? `locked: ${robot.lock_reason}` : "locked";
    if (robot.played) return "a recording";
    const driver = this.driver(robot);
    return driver === null ? "no driver" : `${driver} drive${driver === "you" ? "" : "s"}`;
  }

  private make(name: string): void {
    const input = make("input", { type: "radio", name: "robot", value: name });
    const [state, speed] = [make("span", { class: "what" }), make("span", { class: "speed" })];
    const [battery, signal] = [make("span", { class: "battery" }), make("span", { class: "signal" })];
    const [dot, title] = [make("i", { class: "dot" }), make("b", {}, name)];
    const label = make("label", {}, input, dot, title, state, speed, battery, signal);
    const stop = make("button", { type: "button", "aria-label": `Stop ${name}` }, "Stop");
    const row = make("div", { class: "robot" }, label, stop);
    row.style.setProperty("--robot", robotColour(name));
    input.addEventListener("change", () => this.fleet.choose(name));
    label.addEventListener("mousedown", dropFocus); // after a click the arrow keys drive, and do not choose another robot
    onPress(stop, () => this.stop(name), { isScrolled: true });
    this.cards.set(name, { row, input, name: title, state, speed, battery, signal, stop, share: "" });
  }
}

/** Whether the robots are one line that is scrolled sideways, as on a phone: a count then leads to its robot. */
function isStrip(): boolean {
  return document.body.dataset.robots === "strip";
}

/** By what it is commanded, if that is not a Twist. */
function describeAbilities({ command_type: type }: RobotView): string {
  return !type || type === TWIST ? "" : ` · commanded by ${type.split("/").at(-1)}`;
}

/** What the daemon finds wrong with a connected robot's device, in short; empty if nothing. */
function faultOf({ connected, unreachable, device_errors: errors = [] }: RobotView): string {
  if (!connected) return "";
  if (unreachable) return "cannot receive";
  return (errors[0] ?? "").replaceAll("_", " ");
}

/** A click works without moving the focus; an element that had it loses it. */
function dropFocus(event: MouseEvent): void {
  event.preventDefault();
  if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
}
