/** The stop: over REST, tried until it has arrived; a daemon that can locks the robot too, until it is unlocked. */

import { confirmed, find, setText } from "./dom";
import type { Driving } from "./driving";
import type { Fleet } from "./fleet";
import { notice } from "./notice";
import { ofRobot, reasonOf, Refused, rest } from "./rest";
import type { RobotView } from "./views";

const AGAIN_MS = 200;
const GIVE_UP_MS = 15_000;
const LATE = "The stop has not arrived yet: trying again …";
const BUSY = 429;
const FAILED = 500; // and above: the daemon cannot now, for example because another one has not answered

export class Stop {
  private readonly button = find<HTMLButtonElement>("#stop");
  private readonly unlockAllButton = find<HTMLButtonElement>("#unlock-all");
  private presses = 0;
  private readonly newest = new Map<string, number>(); // the last press that sent a request, by its path
  private readonly waiting = new Set<number>(); // presses of which something has not arrived yet

  constructor(
    private readonly fleet: Fleet,
    private readonly driving: Driving,
  ) {
    onPress(this.button, () => this.press());
    onPress(find("#stop-all"), () => this.stopAll());
    find("#lock-all").addEventListener("click", () => this.lockAll());
    find("#unlock").addEventListener("click", () => void this.unlock());
    confirmed(this.unlockAllButton, "Really unlock?", () => {
      const locked = this.fleet.robots.filter((robot) => robot.locked).map(({ name }) => name);
      return () => void this.unlockAll(locked);
    });
  }

  press(): void {
    const { robot, isKnown, missed } = this.fleet;
    this.flash();
    if (robot !== undefined) void this.deliver(`${robot.name} is stopped.`, robot.name, [lockOf(robot)]);
    else if (!isKnown || missed !== null) this.stopAll();
    else notice("done", "There is no robot to stop.", 3000);
  }

  /** A zero for every robot, also of other daemons; who drives may go on. */
  stopAll(): void {
    this.flash();
    void this.deliver("Every robot is stopped.", "every robot", [{ path: "api/stop" }]);
  }

  lockAll(): void {
    this.flash();
    const locks = this.fleet.robots.map(lockOf);
    void this.deliver(`${locks.length} robots are stopped and locked.`, "every robot", locks);
  }

  /** `canDrive`: only then it may be unlocked. */
  show(canDrive: boolean): void {
    const { robot, robots, missed } = this.fleet;
    setText(
      find("#stop .label"),
      missed !== null ? "Stop all" : robots.length > 1 && robot ? `Stop ${robot.name}` : "Stop",
    );
    find("#lock").hidden = !robot?.locked;
    setText(find("#lock-reason"), robot?.lock_reason ?? "");
    find("#lock-reason").title = robot?.lock_reason ?? "";
    find<HTMLButtonElement>("#unlock").disabled = !canDrive;
    find("#unlock").title = canDrive ? "" : "This token may only read.";
    const locked = robots.filter((each) => each.locked).length;
    find("#robots-locked").hidden = locked === 0 || robots.length < 2;
    setText(find("#robots-locked span"), locked === 1 ? "1 robot is locked" : `${locked} robots are locked`);
    this.unlockAllButton.disabled = !canDrive;
  }

  private flash(): void {
    this.driving.releaseAll();
    this.button.classList.remove("pressed");
    void this.button.offsetWidth; // so that the flash begins anew
    this.button.classList.add("pressed");
  }

  /** Try each request until it has arrived, or a later press has sent the same one. */
  private async deliver(done: string, whom: string, requests: StopRequest[]): Promise<void> {
    const press = ++this.presses;
    const until = performance.now() + GIVE_UP_MS;
    const outcome: Outcome = { missing: requests, refusals: [], reason: "hostlink does not answer" };
    for (const { path } of requests) this.newest.set(path, press);
    while (true) {
      await attempt(outcome);
      const { missing, refusals, reason } = outcome;
      outcome.missing = missing.filter(({ path }) => this.newest.get(path) === press);
      if (missing.length === 0) {
        this.waiting.delete(press);
        if (refusals.length > 0) notice("stop", `Not stopped: ${refusals.join("; ")}`, 6000);
        else if (this.waiting.size === 0) notice("stop", null);
        if (refusals.length === 0) notice("done", done, 2500);
        return;
      }
      const isOver = outcome.missing.length === 0 || performance.now() > until;
      if (isOver) this.waiting.delete(press);
      else this.waiting.add(press);
      if (outcome.missing.length === 0) return;
      notice("stop", isOver ? `The stop did not reach ${whom}: ${reason}.` : `${LATE} ${reason}.`);
      if (isOver) return;
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  private async unlock(): Promise<void> {
    const name = this.fleet.robot?.name;
    if (name === undefined) return;
    try {
      await rest("POST", ofRobot(name, "unlock"));
    } catch (error) {
      notice("refused", `Not unlocked: ${reasonOf(error)}`, 5000);
    }
  }

  /** Those that were locked when it asked. None of them moves by that; one that fails stays locked, and is named. */
  private async unlockAll(locked: string[]): Promise<void> {
    const results = await Promise.allSettled(locked.map((name) => rest("POST", ofRobot(name, "unlock"))));
    const failures = results.flatMap((result, index) =>
      result.status === "rejected" ? [`${locked[index]}: ${reasonOf(result.reason)}`] : [],
    );
    if (failures.length > 0) notice("refused", `Not unlocked: ${failures.join("; ")}`, 6000);
    else notice("done", `${locked.length} ${locked.length === 1 ? "robot" : "robots"} may be driven again.`, 2500);
  }
}

/** As soon as it is pressed: who slides off, scrolls, or has another finger on the stick gives no click. */
function onPress(button: HTMLElement, act: () => void): void {
  let isDone = false; // by the pointer that came down
  button.addEventListener("pointerdown", () => {
    isDone = true;
    act();
  });
  button.addEventListener("click", ({ detail }) => {
    if (detail === 0 || !isDone) act(); // by a key, or by what helps people who have no pointer
    isDone = false;
  });
}

interface StopRequest {
  path: string;
  body?: object;
}

interface Outcome {
  missing: StopRequest[]; // have not arrived
  refusals: string[];
  reason: string; // why the last one has not arrived
}

/** Send what is missing once. */
async function attempt(outcome: Outcome): Promise<void> {
  const { missing, refusals } = outcome;
  outcome.missing = [];
  const send = async (each: StopRequest) => {
    try {
      await rest("POST", each.path, each.body);
    } catch (error) {
      if (error instanceof Refused && error.status !== BUSY && error.status < FAILED) refusals.push(error.message);
      else {
        outcome.missing.push(each);
        outcome.reason = error instanceof Refused ? error.message : "hostlink does not answer";
      }
    }
  };
  await Promise.all(missing.map(send));
}

/** A daemon that cannot lock stops. */
function lockOf(robot: RobotView): StopRequest {
  if (robot.locked === undefined) return { path: ofRobot(robot.name, "stop") };
  return { path: ofRobot(robot.name, "lock"), body: { reason: "the stop on the page" } };
}
