/** The stop, and the lock, which holds until unlock: over REST, repeated until they have arrived. */

import { confirmed, digits, find, setText } from "./dom";
import type { Driving } from "./driving";
import type { Fleet } from "./fleet";
import { commonPrefix, showName, showText } from "./names";
import { notice } from "./notice";
import { onPress } from "./press";
import { ofRobot, reasonOf, Refused, rest } from "./rest";
import type { RobotView, StoppedRobotView } from "./views";

const AGAIN_MS = 200;
const GIVE_UP_MS = 15_000;
const LATE = "The stop has not arrived yet: trying again …";
const BUSY = 429;
const FAILED = 500; // and above: the daemon failed for now, for example because another daemon has not answered
const MEASURED_MS = 4000; // the daemon measures for at most 1.5 s
const DONE_MS = 2500;
const NOT_DONE_MS = 8000;
const SHORTEST_M_S = 0.005; // a slower robot is reported as turning
const NAMED = 3; // moving robots named in one line
const NO_ODOMETRY = "it has no odometry"; // the daemon's reason
const REASON = "the stop on the page";

export class Stop {
  private readonly button = find<HTMLButtonElement>("#stop");
  private readonly unlockAllButton = find<HTMLButtonElement>("#unlock-all");
  private presses = 0;
  private readonly newest = new Map<string, number>(); // the last press that sent a request, by path
  private readonly waiting = new Set<number>(); // presses whose requests have not all arrived
  private stopped: ReadonlySet<string> = new Set(); // robots that the page reports as stopped
  private measurements = 0; // only the newest measurement is shown
  private unmeasured: ReadonlySet<string> | null = new Set(); // robots of the newest measurement; null: all

  constructor(
    private readonly fleet: Fleet,
    private readonly driving: Driving,
  ) {
    onPress(this.button, () => this.lock());
    onPress(find("#stop-all"), () => this.stopAll());
    find("#lock-all").addEventListener("click", () => this.lockAll());
    find("#unlock").addEventListener("click", () => void this.unlock());
    confirmed(this.unlockAllButton, "Really unlock?", () => {
      const locked = this.fleet.robots.filter((robot) => robot.locked).map(({ name }) => name);
      return () => void this.unlockAll(locked);
    });
  }

  /** Lock the chosen robot: zero velocity at once, commands are refused until unlock. */
  lock(): void {
    this.interrupt(lockOf);
  }

  /** Stop the chosen robot: its driver must release first, and may drive again. */
  stop(): void {
    this.interrupt(({ name }) => ({ path: ofRobot(name, "stop") }));
  }

  private interrupt(requestOf: (robot: RobotView) => StopRequest): void {
    const { robot, isKnown, missed } = this.fleet;
    this.flash();
    if (robot !== undefined) void this.deliver(robot.name, [requestOf(robot)], new Set([robot.name]));
    else if (!isKnown || missed !== null) this.stopAll();
    else notice("done", "No robot to stop.", 3000);
  }

  /** Stop every robot, also of other daemons. */
  stopAll(): void {
    this.flash();
    void this.deliver("every robot", [{ path: "api/stop" }], null);
  }

  /** Stop a robot that need not be the chosen one. */
  stopOne(name: string): void {
    this.flash();
    void this.deliver(name, [{ path: ofRobot(name, "stop") }], new Set([name]));
  }

  /** Lock every robot and every board, also of other daemons, and what connects later. */
  lockAll(): void {
    this.flash();
    void this.deliver("every robot", [{ path: "api/lock", body: { reason: REASON } }], null);
  }

  /** `canDrive`: whether the user may unlock. */
  show(canDrive: boolean): void {
    const { robot, robots, missed } = this.fleet;
    const label = find("#stop .label");
    if (robots.length > 1 && robot && missed === null) {
      showName(label, robot.name, commonPrefix(robots.map(({ name }) => name)), "Stop ");
    } else showText(label, missed !== null ? "Stop all" : "Stop");
    find("#stop-all").hidden = missed !== null || robots.length < 2;
    find("#lock").hidden = !robot?.locked;
    const reason = find("#lock-reason");
    setText(reason, robot?.lock_reason ?? "");
    reason.tabIndex = reason.scrollHeight > reason.clientHeight + 1 ? 0 : -1; // keys scroll a very long one
    find<HTMLButtonElement>("#unlock").disabled = !canDrive;
    find("#unlock").title = canDrive ? "" : "This token has the role read.";
    const locked = robots.filter((each) => each.locked).length;
    this.unlockAllButton.hidden = locked === 0 || robots.length < 2;
    this.unlockAllButton.disabled = !canDrive;
    if (robots.some(({ name, holder }) => holder !== null && this.stopped.has(name))) this.confirm(new Set());
  }

  private flash(): void {
    this.driving.releaseAll();
    this.button.classList.remove("pressed");
    void this.button.offsetWidth; // restarts the animation
    this.button.classList.add("pressed");
  }

  /**
   * Repeat each request until it has arrived, or a later press has sent the same one. Then show the measured result of
   * `names`; null: of every robot.
   */
  private async deliver(whom: string, requests: StopRequest[], names: ReadonlySet<string> | null): Promise<void> {
    const press = ++this.presses;
    const until = performance.now() + GIVE_UP_MS;
    const outcome: Outcome = { missing: requests, refusals: [], reason: "hostlink does not answer", endpoints: [] };
    for (const { path } of requests) this.newest.set(path, press);
    while (true) {
      await attempt(outcome);
      const { missing, refusals, reason } = outcome;
      outcome.missing = missing.filter(({ path }) => this.newest.get(path) === press);
      if (missing.length === 0) {
        this.waiting.delete(press);
        if (refusals.length > 0) {
          this.measurements++; // an earlier press must not replace the refusal
          notice("stop", `Not stopped: ${refusals.join("; ")}`, 6000);
        } else {
          if (this.waiting.size === 0) notice("stop", null);
          await this.measure(whom, names, outcome.endpoints);
        }
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

  /**
   * Show the measured result since the stop arrived, with robots of earlier presses that were not measured yet.
   * A later press that arrives meanwhile measures them again.
   */
  private async measure(
    whom: string,
    arrived: ReadonlySet<string> | null,
    endpoints: CommandEndpointView[],
  ): Promise<void> {
    const measurement = ++this.measurements;
    const isShown = (): boolean => measurement === this.measurements && this.waiting.size === 0;
    const names = arrived === null || this.unmeasured === null ? null : new Set([...arrived, ...this.unmeasured]);
    this.unmeasured = names;
    this.confirm(new Set(), `The stop has reached ${whom}.`);
    const only = names?.size === 1 ? [...names][0] : undefined;
    try {
      const path = only === undefined ? "api/standstill" : ofRobot(only, "standstill");
      const answer = await rest<StoppedRobotView | { robots: StoppedRobotView[] }>("GET", path, undefined, MEASURED_MS);
      if (!isShown()) return;
      this.unmeasured = new Set();
      const all = "robots" in answer ? answer.robots : [answer];
      const robots = all.filter((robot) => names?.has(robot.name) ?? !robot.played);
      const stopped = robots.filter(({ standstill }) => standstill.state === "stopped").map(({ name }) => name);
      const uncovered = endpoints.map(ofBoard);
      const areStopped = stopped.length === robots.length;
      if (areStopped && uncovered.length === 0) this.confirm(new Set(stopped), allStopped(stopped));
      else {
        const text = areStopped
          ? robots.length > 0
            ? [allStopped(stopped)]
            : []
          : [notAllStopped(robots, stopped.length)];
        notice("stop", [...text, ...uncovered].join(" "), NOT_DONE_MS);
      }
    } catch (error) {
      if (isShown()) notice("stop", `Whether ${whom} is stopped is unknown: ${reasonOf(error)}`, NOT_DONE_MS);
    }
  }

  /** Report these robots as stopped until one of them is driven. */
  private confirm(stopped: ReadonlySet<string>, text: string | null = null): void {
    this.stopped = stopped;
    notice("done", text, text === null ? undefined : DONE_MS);
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

  /** Unlock every robot and every board; `locked` were locked at the first press. They do not move by that. */
  private async unlockAll(locked: string[]): Promise<void> {
    try {
      await rest("POST", "api/unlock");
      notice("done", `${locked.length} ${locked.length === 1 ? "robot" : "robots"} unlocked.`, 2500);
    } catch (error) {
      notice("refused", `Not unlocked: ${reasonOf(error)}`, 6000);
    }
  }
}

/** A topic of a board that commands a motion and is not a robot's, after a stop or a lock of all. */
interface CommandEndpointView {
  peer: string;
  topic: string;
  is_zero_sent: boolean;
  reason: string; // why it was not sent a zero
  host: string | null; // daemon of the fleet that has the board; null: this one
}

interface StopRequest {
  path: string;
  body?: object;
}

interface Outcome {
  missing: StopRequest[]; // not arrived yet
  refusals: string[];
  reason: string; // of the last failed attempt
  endpoints: CommandEndpointView[]; // of boards, after a stop or a lock of all
}

/** Send the missing requests once. */
async function attempt(outcome: Outcome): Promise<void> {
  const { missing, refusals } = outcome;
  outcome.missing = [];
  const send = async (each: StopRequest) => {
    try {
      const answer = await rest<{ endpoints?: CommandEndpointView[] }>("POST", `${each.path}?wait_s=0`, each.body);
      outcome.endpoints.push(...(answer.endpoints ?? []));
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

function lockOf(robot: RobotView): StopRequest {
  return { path: ofRobot(robot.name, "lock"), body: { reason: REASON } };
}

function allStopped(names: string[]): string {
  if (names.length === 0) return "No robot to stop.";
  return names.length === 1 ? `${names[0]} is stopped.` : `All ${names.length} robots are stopped.`;
}

/** What became of a topic that is not a robot's. */
function ofBoard({ peer, topic, is_zero_sent, reason, host }: CommandEndpointView): string {
  const place = host === null ? `${topic} of ${peer}` : `${topic} of ${peer} at ${host}`;
  if (!is_zero_sent) return `${place} was not sent a zero: ${reason}.`;
  return `${place}: zero sent; it is not a robot's, so nobody can say that it is stopped.`;
}

/** `2 of 3 robots are stopped. robot_1 moves at 0.10 m/s, driven by client 3.` */
function notAllStopped(robots: StoppedRobotView[], stopped: number): string {
  const others = robots.filter(({ standstill }) => standstill.state !== "stopped");
  const sentences = others.slice(0, NAMED).map(describe);
  if (others.length > NAMED) sentences.push(`${others.length - NAMED} more are not confirmed as stopped.`);
  if (robots.length > 1) sentences.unshift(`${stopped} of ${robots.length} robots are stopped.`);
  return sentences.join(" ");
}

function describe({ name, standstill }: StoppedRobotView): string {
  const { state, reason } = standstill;
  if (reason === NO_ODOMETRY) return `Zero sent; ${name} has no odometry, so nobody can say that it is stopped.`;
  if (state === "unknown") return `Whether ${name} is stopped is unknown: ${reason}.`;
  const [speed, turn] = [Math.abs(standstill.speed_m_s ?? 0), Math.abs(standstill.turn_rad_s ?? 0)];
  const motion = speed > SHORTEST_M_S ? `moves at ${digits(speed, 2)} m/s` : `turns at ${digits(turn, 2)} rad/s`;
  return `${name} ${motion}${reason.startsWith("driven by") ? "," : ":"} ${reason}.`;
}
