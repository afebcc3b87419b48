/** The drive panel: from what is held to commands on the robot's velocity topic, and why they do not work if so. */

import type { Connection, DriveAnswer } from "./connection";
import { ageText, digits, find, remember, remembered, setText } from "./dom";
import { Driving, TICK_MS } from "./driving";
import type { Fleet } from "./fleet";
import { connectGamepad } from "./gamepad";
import { connectJoystick } from "./joystick";
import { connectKeys, LOST } from "./keys";
import { named, type RobotView, type Velocity } from "./views";

const TELEOP_PRIORITY = 60; // a person goes before a program, which has 50
const UNANSWERED_MS = 250; // then nothing more is sent until an answer comes: it would only be old when it arrives
const REFUSED_MS = 1500; // a refusal that is older is over
const AFTERGLOW_MS = 900; // the daemon may still name this page as the driver

const LEASE_MS = 500;
const HELD = "held"; // the kind of a refusal: another source drives with a higher priority

const STANDING: Velocity = { linear_m_s: 0, angular_rad_s: 0 };

export class Drive {
  readonly driving = new Driving((velocity) => this.send(velocity));

  private target: RobotView | undefined; // of the commands; only changed when nothing is held
  private motion = 0; // its number; a new one begins when something is held, and when nothing is any more
  private epoch: number | null = null; // of the robot, as the first answer of this motion gave it
  private unanswered: { at: number; motion: number }[] = []; // the commands that were sent
  private refusal = "";
  private refusedAt = Number.NEGATIVE_INFINITY;
  private droveAt = Number.NEGATIVE_INFINITY;
  private wasHeld = false; // when the command before was sent
  private readonly pause = new Pause();
  private readonly holders = new Map<string, number>(); // who held the robot while the stick was held here, and when

  constructor(
    private readonly fleet: Fleet,
    private readonly connection: Connection,
    private readonly canDrive: () => boolean,
  ) {
    this.connectSlider("linear", "m/s", 2, 0.2);
    this.connectSlider("angular", "rad/s", 1, 1);
    setInterval(() => this.tick(), TICK_MS);
    for (const event of [...LOST, "pagehide"]) addEventListener(event, () => this.driving.releaseAll());
    document.addEventListener("visibilitychange", () => document.hidden && this.driving.releaseAll());
  }

  /** `stop` is what Space and the gamepad's button do, `lock` what L and Escape do. */
  connectInputs(stop: () => void, lock: () => void): void {
    connectJoystick(find("#joystick"), this.driving);
    connectKeys(this.driving, stop, lock);
    connectGamepad(find("#gamepad"), this.driving, stop);
  }

  /** Who drives this robot, in words. */
  driver(robot: RobotView): string | null {
    if (robot.holder === null) return null;
    const isMine = robot.name === this.target?.name && performance.now() - this.droveAt < AFTERGLOW_MS;
    return isMine && !this.isRefused ? "you" : named(robot.holder, robot.holder_address);
  }

  /** The stick waits for a source with a higher priority; after any other refusal it must be released first. */
  answered(answer: DriveAnswer): void {
    const command = this.unanswered.shift();
    if (answer.result) {
      if (command?.motion === this.motion) this.epoch ??= answer.epoch ?? null;
      return;
    }
    if (answer.kind !== HELD) this.driving.releaseAll();
    this.refusal = answer.reason ?? "";
    this.refusedAt = performance.now();
    this.show();
  }

  /** The connection is another one, or none: what was sent will not be answered. */
  forget(): void {
    this.driving.releaseAll();
    this.unanswered = [];
  }

  show(): void {
    const { robot } = this.fleet;
    if (robot?.name !== this.target?.name || robot?.velocity_topic !== this.target?.velocity_topic) {
      this.driving.releaseAll(); // the zeros go to the robot that was driven
    }
    this.target = robot;
    if (!this.driving.isHeld) this.holders.clear();
    else if (robot?.holder) this.holders.set(robot.holder, performance.now());
    if (robot?.locked || robot?.connected === false || !this.canDrive()) this.driving.releaseAll();
    find("#read-only").hidden = this.canDrive() || robot?.locked === true;
    for (const slider of document.querySelectorAll<HTMLInputElement>("#drive input"))
      slider.disabled = !this.canDrive();
    const [state, text] = this.describe(robot);
    find("#drive").dataset.state = state;
    setText(find("#drive-state"), text);
    find("#drive-state").title = text;
  }

  /** Of one priority the newest command counts: two who hold the stick take it from each other. */
  private get hasRival(): boolean {
    const since = performance.now() - AFTERGLOW_MS;
    return [...this.holders.values()].filter((at) => at > since).length > 1;
  }

  private get isRefused(): boolean {
    return performance.now() - this.refusedAt < REFUSED_MS;
  }

  private describe(robot: RobotView | undefined): [state: string, text: string] {
    if (this.connection.state !== "open") return ["gone", "No connection"];
    const { missed } = this.fleet;
    if (missed !== null) return ["gone", `Choose a robot: ${missed} is not there any more`];
    if (robot === undefined) return ["idle", "No robot yet"];
    if (!robot.connected) return ["gone", `${robot.name} is not connected`];
    if (!this.canDrive()) return ["read", "This token may only read"];
    if (!this.fleet.isHeard) return ["silent", `No news of ${robot.name} for ${ageText(this.fleet.age_s(robot))}`];
    if (this.fleet.isSilent(robot)) {
      return ["silent", `${robot.name}: silent for ${ageText(this.fleet.age_s(robot))}`];
    }
    if (robot.locked) return ["locked", `${robot.name} is locked`];
    if (robot.played) return ["other", "A recording: it obeys nobody"];
    if (this.isRefused) return ["refused", this.refusal];
    if (robot.unreachable) return ["refused", `${robot.name} cannot receive: ${robot.unreachable}`];
    const driver = this.driver(robot);
    if (driver === "you" && this.hasRival) return ["other", "Somebody else drives it, too: let go"];
    if (driver === "you") return ["driving", "You drive"];
    if ((robot.priority ?? 0) > TELEOP_PRIORITY) return ["other", `Goes before you: ${driver}`];
    if (driver !== null) return ["other", `Your stick takes over: ${driver} drives`];
    return ["idle", "Ready: nobody drives"];
  }

  private tick(): void {
    if (this.pause.isLong())
      this.driving.releaseAll(); // the robot has stopped, and what was let go is not known
    else this.driving.tick();
    const command = this.canDrive() ? this.driving.velocity() : STANDING;
    setText(find("#command-linear"), digits(command.linear_m_s, 2));
    setText(find("#command-angular"), digits(command.angular_rad_s, 2));
  }

  private send(velocity: Velocity): void {
    if (!this.target?.connected || !this.canDrive()) return;
    const now = performance.now();
    const { isHeld } = this.driving;
    if (isHeld && now - (this.unanswered[0]?.at ?? now) > UNANSWERED_MS) return;
    if (isHeld !== this.wasHeld) {
      this.wasHeld = isHeld;
      this.motion += 1;
      this.epoch = null;
    }
    const isSent = this.connection.drive({
      robot: this.target.name,
      linear: velocity.linear_m_s,
      angular: velocity.angular_rad_s,
      priority: TELEOP_PRIORITY,
      epoch: this.epoch,
      sent_s: now / 1000,
    });
    if (!isSent) return;
    this.droveAt = now;
    this.unanswered.push({ at: now, motion: this.motion });
  }

  /** A new speed is for what is held then; it moves nothing by itself. */
  private connectSlider(part: "linear" | "angular", unit: string, places: number, otherwise: number): void {
    const slider = find<HTMLInputElement>(`#max-${part}`);
    const apply = () => {
      this.driving.limits[part === "linear" ? "linear_m_s" : "angular_rad_s"] = slider.valueAsNumber;
      setText(find(`[for=max-${part}]:is(output)`), `${digits(slider.valueAsNumber, places)} ${unit}`);
    };
    slider.value = remembered(`max.${part}`, String(otherwise));
    slider.addEventListener("input", () => {
      remember(`max.${part}`, slider.value);
      apply();
    });
    apply();
  }
}

/** Whether the page has not run for longer than a command lasts: by its clock, or by the time of day while it slept. */
class Pause {
  private ranAt = performance.now();
  private wallAt = Date.now();

  isLong(): boolean {
    const [now, wall] = [performance.now(), Date.now()];
    const pause_ms = Math.max(now - this.ranAt, wall - this.wallAt);
    [this.ranAt, this.wallAt] = [now, wall];
    return pause_ms > LEASE_MS;
  }
}
