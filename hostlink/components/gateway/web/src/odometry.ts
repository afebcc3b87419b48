/** The chosen robot's pose in numbers, and the button that resets its odometry. */

import { ageText, confirmed, digits, find, make, setText } from "./dom";
import type { Fleet } from "./fleet";
import { notice } from "./notice";
import { ofRobot, reasonOf, rest } from "./rest";
import { motionText } from "./views";

const ROWS = ["x", "y", "heading", "speed"] as const;

export class Odometry {
  private readonly button = find<HTMLButtonElement>("#odometry-reset");
  private readonly age = make("dd");
  private readonly values: Record<(typeof ROWS)[number], HTMLElement>;

  constructor(
    private readonly fleet: Fleet,
    private readonly onReset: (name: string) => void,
  ) {
    this.values = Object.fromEntries(
      ROWS.map((row) => {
        const value = make("dd", {}, "–");
        find("#pose").append(make("div", {}, make("dt", {}, row), value));
        return [row, value];
      }),
    ) as typeof this.values;
    find("#pose").prepend(make("div", { class: "age" }, this.age));
    confirmed(this.button, "Really reset?", () => {
      const name = this.fleet.robot?.name;
      return () => void this.reset(name);
    });
  }

  /** `canDrive`: whether the user may reset it. */
  show(canDrive: boolean): void {
    const { robot } = this.fleet;
    const state = robot ? this.fleet.state(robot) : "connected";
    this.button.disabled = !robot?.connected || !canDrive || robot.feedback === "none";
    const isStale = state === "silent" || state === "unknown";
    find("#pose").classList.toggle("stale", isStale);
    find("#pose").classList.toggle("gone", state === "gone");
    const isOld = robot && (isStale || state === "gone");
    setText(this.age, isOld ? `${ageText(this.fleet.age_s(robot))} old` : "");
    const pose = robot?.odometry?.pose;
    setText(this.values.x, pose ? `${digits(pose.x_m, 2)} m` : "–");
    setText(this.values.y, pose ? `${digits(pose.y_m, 2)} m` : "–");
    setText(this.values.heading, pose ? `${digits((pose.theta_rad * 180) / Math.PI, 0)}°` : "–");
    setText(this.values.speed, robot?.connected && !isStale ? motionText(robot) : "–");
  }

  private async reset(name: string | undefined): Promise<void> {
    if (name === undefined) return;
    try {
      await rest("POST", ofRobot(name, "odometry/reset"));
      this.onReset(name);
    } catch (error) {
      notice("refused", `Not reset: ${reasonOf(error)}`, 5000);
    }
  }
}
