/** PID gains of both wheels, sent to the robot's tuning topics. The robot does not publish its present gains. */

import type { Connection } from "./connection";
import { find, make, remember, remembered, setText } from "./dom";
import type { Fleet } from "./fleet";
import { timeText } from "./times";
import { KeptGains } from "./keptgains";
import { topicOf } from "./views";

const TYPE = "geometry_msgs/Vector3";
const SIDES = ["l", "r"] as const;
const GAINS = ["x", "y", "z"] as const;
const NAMES = { x: "Kp", y: "Ki", z: "Kd" };
const PAPER = { l: { x: "23", y: "36", z: "0.1" }, r: { x: "24", y: "35", z: "0.1" } }; // docs/paper-robot.md#numbers

type Side = (typeof SIDES)[number];

export class Tuning {
  private readonly state = find("#tuning-state");
  private readonly inputs = new Map<string, HTMLInputElement>();
  private shown = "";

  constructor(
    private readonly fleet: Fleet,
    private readonly connection: Connection,
    private readonly canDrive: () => boolean,
  ) {
    const rows = document.querySelectorAll("#tuning .gains tbody tr");
    SIDES.forEach((side, index) => {
      for (const gain of GAINS) {
        const name = `${side === "l" ? "Left" : "Right"} ${NAMES[gain]}`;
        const input = make("input", { type: "number", min: "0", step: "any", required: "", "aria-label": name });
        this.inputs.set(side + gain, input);
        rows[index]?.append(make("td", {}, input));
      }
    });
    find<HTMLFormElement>("#tuning .gains").addEventListener("submit", (event) => {
      event.preventDefault();
      this.send();
    });
    new KeptGains(
      find("#tuning"),
      () => Object.fromEntries([...this.inputs].map(([key, { value }]) => [key, value])),
      (gains) => {
        for (const [key, input] of this.inputs) input.value = gains[key] ?? input.value;
        setText(this.state, "Not sent yet.");
      },
    );
    this.show(); // nothing can be typed before the robot's gains are shown, which would replace it
  }

  show(): void {
    const { robot } = this.fleet;
    const isTunable = SIDES.every((side) => this.topic(side) !== null);
    for (const control of document.querySelectorAll<HTMLInputElement>("#tuning .gains input, #tuning .gains button")) {
      control.disabled = !isTunable || !this.canDrive();
    }
    if (robot && robot.name !== this.shown) {
      this.shown = robot.name;
      for (const side of SIDES) {
        for (const gain of GAINS) {
          const input = this.inputs.get(side + gain);
          if (input) input.value = remembered(`gain.${robot.name}.${side}${gain}`, PAPER[side][gain]);
        }
      }
      setText(this.state, "");
    }
    if (robot?.connected && this.fleet.link && !isTunable) setText(this.state, "This robot has no tuning topics.");
  }

  /** Show that its message was refused. */
  refused(topic: string, reason: string): void {
    if (SIDES.some((side) => topic === this.topic(side))) setText(this.state, reason);
  }

  private topic(side: Side): string | null {
    const { robot, link } = this.fleet;
    return robot ? topicOf(robot, link, `pid_tune_${side}`, TYPE) : null;
  }

  private send(): void {
    let isSent = true;
    for (const side of SIDES) {
      const topic = this.topic(side);
      const gains: Record<string, number> = {};
      for (const gain of GAINS) {
        const value = this.inputs.get(side + gain)?.value ?? "";
        gains[gain] = Number(value);
        remember(`gain.${this.shown}.${side}${gain}`, value);
      }
      isSent = topic !== null && this.connection.publish(topic, gains) && isSent;
    }
    const time = timeText(new Date());
    setText(this.state, isSent ? `Sent at ${time}.` : "Not sent: no connection.");
  }
}
