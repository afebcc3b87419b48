/** The stop: over REST, tried until it has arrived; a daemon that can locks the robot too, until it is unlocked. */

import { find, setText } from "./dom";
import type { Driving } from "./driving";
import type { Fleet } from "./fleet";
import { notice } from "./notice";
import { ofRobot, Refused, rest } from "./rest";

const AGAIN_MS = 200;
const GIVE_UP_MS = 15_000;

export class Stop {
  private readonly button = find<HTMLButtonElement>("#stop");
  private presses = 0;

  constructor(
    private readonly fleet: Fleet,
    private readonly driving: Driving,
  ) {
    this.button.addEventListener("click", () => this.press());
    find("#unlock").addEventListener("click", () => void this.unlock());
  }

  press(): void {
    this.driving.releaseAll();
    const { robot, isKnown } = this.fleet;
    this.button.classList.remove("pressed");
    void this.button.offsetWidth; // so that the flash begins anew
    this.button.classList.add("pressed");
    if (robot?.locked !== undefined) {
      void this.deliver(robot.name, ofRobot(robot.name, "lock"), { reason: "the stop on the page" });
    } else if (robot !== undefined) void this.deliver(robot.name, ofRobot(robot.name, "stop"));
    else if (!isKnown) void this.deliver("Every robot", "api/stop");
    else notice("done", "There is no robot to stop.", 3000);
  }

  show(): void {
    const { robot, robots } = this.fleet;
    setText(find("#stop .label"), robots.length > 1 && robot ? `Stop ${robot.name}` : "Stop");
    find("#lock").hidden = !robot?.locked;
    setText(find("#lock-reason"), robot?.lock_reason ?? "");
  }

  private async deliver(name: string, path: string, body?: object): Promise<void> {
    const press = ++this.presses;
    const until = performance.now() + GIVE_UP_MS;
    while (press === this.presses) {
      try {
        await rest("POST", path, body);
        notice("stop", null);
        notice("done", `${name} is stopped.`, 2500);
        return;
      } catch (error) {
        if (error instanceof Refused) {
          notice("stop", `Stop: ${error.message}`, 6000);
          return;
        }
      }
      if (performance.now() > until) {
        notice("stop", `The stop did not reach ${name}: hostlink does not answer.`);
        return;
      }
      notice("stop", `The stop has not arrived yet: trying again …`);
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  private async unlock(): Promise<void> {
    const name = this.fleet.robot?.name;
    if (name === undefined) return;
    try {
      await rest("POST", ofRobot(name, "unlock"));
    } catch (error) {
      notice("refused", `Unlock: ${error instanceof Error ? error.message : String(error)}`, 5000);
    }
  }
}
