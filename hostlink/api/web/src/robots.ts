/** The robots and what each of them does; one of them is chosen. */

import { digits, find, make, setText } from "./dom";
import type { Fleet } from "./fleet";
import type { RobotView } from "./views";

interface Card {
  label: HTMLLabelElement;
  input: HTMLInputElement;
  state: HTMLElement;
  speed: HTMLElement;
}

export class RobotList {
  private readonly list = find("#robots .list");
  private readonly cards = new Map<string, Card>();

  constructor(
    private readonly fleet: Fleet,
    private readonly driver: (robot: RobotView) => string | null,
  ) {}

  /** `isHeard`: the daemon was; else nobody knows that there is no robot. */
  show(isHeard: boolean | null): void {
    const { robots, robot: chosen } = this.fleet;
    find("#robots .empty").hidden = robots.length > 0 || !isHeard;
    for (const robot of robots) {
      const card = this.cards.get(robot.name) ?? this.add(robot.name);
      card.input.checked = robot === chosen;
      card.label.dataset.state = robot.locked ? "locked" : robot.connected ? "connected" : "gone";
      setText(card.state, this.describe(robot));
      setText(card.speed, robot.connected ? `${digits(robot.odometry?.twist.linear_m_s, 2)} m/s` : "");
    }
  }

  private describe(robot: RobotView): string {
    const host = robot.host ? `, at ${robot.host}` : "";
    const others = robot.also_at?.length ? `; this name is also at ${robot.also_at.join(", ")}` : "";
    return `${this.describeDriver(robot)}${host}${others}`;
  }

  private describeDriver(robot: RobotView): string {
    if (!robot.connected) return "not connected";
    if (robot.locked) return "locked";
    const driver = this.driver(robot);
    return driver === null ? "nobody drives" : `${driver} drive${driver === "you" ? "" : "s"}`;
  }

  private add(name: string): Card {
    const input = make("input", { type: "radio", name: "robot", value: name });
    const [state, speed] = [make("span", { class: "what" }), make("span", { class: "speed" })];
    const label = make("label", { class: "robot" }, input, make("b", {}, name), state, speed);
    input.addEventListener("change", () => this.fleet.choose(name));
    this.list.append(label);
    const card = { label, input, state, speed };
    this.cards.set(name, card);
    return card;
  }
}
