/** The list of robots and their state; one of them is chosen. */

import { ageText, arrange, digits, find, make, setText } from "./dom";
import type { Fleet } from "./fleet";
import { batteryText } from "./health";
import { robotColour } from "./robot_colours";
import { type RobotView, speedText } from "./views";

const FILTERED = 8; // with more robots a filter is shown

interface Card {
  label: HTMLLabelElement;
  input: HTMLInputElement;
  state: HTMLElement;
  speed: HTMLElement;
  battery: HTMLElement;
  signal: HTMLElement;
}

export class RobotList {
  private readonly list = find("#robots .list");
  private readonly filter = find<HTMLInputElement>("#robots-filter");
  private readonly cards = new Map<string, Card>();
  private order = "";
  private shown = ""; // the chosen robot and the order of the list

  constructor(
    private readonly fleet: Fleet,
    private readonly driver: (robot: RobotView) => string | null,
  ) {
    this.filter.addEventListener("input", () => this.show(true));
  }

  /** `isHeard`: whether the daemon is heard; otherwise a missing robot is not reported. */
  show(isHeard: boolean | null): void {
    const { robots, robot: chosen } = this.fleet;
    find("#robots .empty").hidden = robots.length > 0 || !isHeard;
    find("#robots-all").hidden = robots.length < 2;
    this.filter.hidden = robots.length <= FILTERED;
    this.arrange(robots);
    const words = this.filter.hidden ? [] : this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const robot of robots) {
      const card = this.cards.get(robot.name);
      if (card === undefined) continue;
      const what = this.describe(robot);
      const isMatch = words.every((word) => `${robot.name} ${what}`.toLowerCase().includes(word));
      card.label.hidden = !isMatch;
      shown += Number(isMatch);
      card.input.checked = robot === chosen;
      this.fill(card, robot, what);
    }
    this.reveal(chosen?.name ?? "");
    find("#robots .none").hidden = shown > 0 || robots.length === 0;
  }

  /** Scroll to the chosen robot once, so that the user can scroll on. */
  private reveal(name: string): void {
    const key = `${name} ${document.body.dataset["robots"]} ${this.order}`;
    if (key === this.shown) return;
    this.shown = key;
    this.cards.get(name)?.label.scrollIntoView({ block: "nearest", inline: "nearest" });
  }

  private fill(card: Card, robot: RobotView, what: string): void {
    const { fleet } = this;
    const state = fleet.state(robot);
    card.label.dataset.state = state === "connected" && this.driver(robot) !== null ? "driving" : state;
    card.label.title = robot.host ? `${robot.name}: ${what}` : what;
    setText(card.state, what);
    const isKnown = state !== "unknown"; // an old state is not enough to drive by
    setText(card.speed, isKnown && robot.connected ? speedText(robot.odometry?.twist) : "");
    setText(card.battery, (isKnown && batteryText(robot)) || "");
    const dbm = (isKnown && robot.signal_dbm) || null;
    const rate = isKnown && robot.connected && robot.odometry ? `${digits(robot.odometry.rate_hz, 0)} Hz` : "";
    setText(card.signal, [rate, dbm === null ? "" : `${digits(dbm, 0)} dBm`].filter(Boolean).join(" "));
  }

  /** Update the cards in the fleet's order. Forgotten robots are removed. */
  private arrange(robots: RobotView[]): void {
    const order = robots.map(({ name }) => name).join("\n");
    if (order === this.order) return;
    this.order = order;
    const names = new Set(robots.map(({ name }) => name));
    for (const name of this.cards.keys()) if (!names.has(name)) this.cards.delete(name);
    const cards = robots.map(({ name }) => this.cards.get(name) ?? this.make(name));
    arrange(
      this.list,
      cards.map(({ label }) => label),
    );
  }

  private describe(robot: RobotView): string {
    const host = robot.host ? ` · at ${robot.host}` : "";
    const others = robot.also_at?.length ? ` · same name at ${robot.also_at.join(", ")}` : "";
    return `${this.describeDriver(robot)}${host}${others}`;
  }

  private describeDriver(robot: RobotView): string {
    const state = this.fleet.state(robot);
    if (state === "unknown") return `heard ${ageText(this.fleet.age_s(robot))} ago`;
    if (state === "gone") return "not connected";
    if (state === "silent") return `silent ${ageText(this.fleet.age_s(robot))}`;
    if (state === "locked") return "locked";
    if (robot.played) return "a recording";
    const driver = this.driver(robot);
    return driver === null ? "no driver" : `${driver} drive${driver === "you" ? "" : "s"}`;
  }

  private make(name: string): Card {
    const input = make("input", { type: "radio", name: "robot", value: name });
    const [state, speed] = [make("span", { class: "what" }), make("span", { class: "speed" })];
    const [battery, signal] = [make("span", { class: "battery" }), make("span", { class: "signal" })];
    const dot = make("i", { class: "dot" });
    const label = make("label", { class: "robot" }, input, dot, make("b", {}, name), state, speed, battery, signal);
    label.style.setProperty("--robot", robotColour(name));
    input.addEventListener("change", () => this.fleet.choose(name));
    label.addEventListener("mousedown", dropFocus); // after a click the arrow keys drive, and do not choose another robot
    const card = { label, input, state, speed, battery, signal };
    this.cards.set(name, card);
    return card;
  }
}

/** A click works without moving the focus; an element that had it loses it. */
function dropFocus(event: MouseEvent): void {
  event.preventDefault();
  if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
}
