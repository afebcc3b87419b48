/** The chosen robot's pose in numbers, and the button that makes the present place the origin. */

import { digits, find, make, setText } from "./dom";
import type { Fleet } from "./fleet";
import { notice } from "./notice";
import { ofRobot, rest } from "./rest";

const ROWS = ["x", "y", "heading", "speed"] as const;

export class Odometry {
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
    find("#odometry-reset").addEventListener("click", () => void this.reset());
  }

  show(): void {
    const { robot } = this.fleet;
    find<HTMLButtonElement>("#odometry-reset").disabled = !robot?.connected;
    const { pose, twist } = robot?.odometry ?? {};
    setText(this.values.x, pose ? `${digits(pose.x_m, 2)} m` : "–");
    setText(this.values.y, pose ? `${digits(pose.y_m, 2)} m` : "–");
    setText(this.values.heading, pose ? `${digits((pose.theta_rad * 180) / Math.PI, 0)}°` : "–");
    setText(this.values.speed, twist ? `${digits(twist.linear_m_s, 2)} m/s` : "–");
  }

  private async reset(): Promise<void> {
    const name = this.fleet.robot?.name;
    if (name === undefined) return;
    try {
      await rest("POST", ofRobot(name, "odometry/reset"));
      this.onReset(name);
    } catch (error) {
      notice("refused", `Reset: ${error instanceof Error ? error.message : String(error)}`, 5000);
    }
  }
}
