/** The chosen robot's pose in numbers, and the button that makes the present place the origin. */

import { digits, find, make, say } from "./dom";
import type { Fleet } from "./fleet";
import { notice } from "./notice";
import { ofRobot, rest } from "./rest";
import type { Pose } from "./views";

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

  /** Ten times a second; the speed comes with the robot's view. */
  seePose(pose: Pose): void {
    say(this.values.x, `${digits(pose.x_m, 2)} m`);
    say(this.values.y, `${digits(pose.y_m, 2)} m`);
    say(this.values.heading, `${digits((pose.theta_rad * 180) / Math.PI, 0)}°`);
  }

  show(): void {
    const { robot } = this.fleet;
    find<HTMLButtonElement>("#odometry-reset").disabled = !robot?.connected;
    say(this.values.speed, robot?.odometry ? `${digits(robot.odometry.twist.linear_m_s, 2)} m/s` : "–");
    if (robot?.odometry) return;
    for (const row of ["x", "y", "heading"] as const) say(this.values[row], "–");
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
