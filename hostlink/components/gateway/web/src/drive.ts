/** The drive panel: sends velocity commands for held controls, and shows why the robot cannot be driven. */

import { driverText } from "./clients";
import type { Connection, DriveAnswer } from "./connection";
import { ageText, digits, find, remember, remembered, setText } from "./dom";
import { type Deflection, Driving, isZero, type Source, STANDING, TICK_MS } from "./driving";
import type { Fleet } from "./fleet";
import { connectGamepad } from "./gamepad";
import { connectJoystick, isStickShown } from "./joystick";
import { connectKeys, LOST } from "./keys";
import { hasSideways, type RobotView, turnsInPlace, type Velocity } from "./views";

const TELEOP_PRIORITY = 60; // above the 50 of programs
const UNANSWERED_MS = 250; // without an answer for this time nothing more is sent: commands would arrive late
const REFUSED_MS = 1500; // an older refusal is not shown
const AFTERGLOW_MS = 900; // the daemon may still name this page as the driver
const LEASE_MS = 500;
const SEEN: Source[] = ["joystick", "keys", "gamepad"]; // they drive where the stick is visible
// kinds of refusals: another source drives with a higher priority or the same one; the robot was stopped meanwhile
const [HELD, DISARMED] = ["held", "disarmed"];

export class Drive {
  readonly driving = new Driving((velocity) => this.send(velocity));

  private target: RobotView | undefined; // of the commands; changes only while nothing is held
  private motion = 0; // of the newest command: `Driving.motion`
  private epoch: number | null = null; // of the robot, from the first answer of this motion
  private unanswered: { at: number; motion: number; takesOver: boolean; isZero: boolean }[] = []; // without an answer
  private name: string | null = null; // of this page's connection at the daemon, from the newest answer
  private takesOver = false; // the next commands take the robot over, until one is accepted
  private refusal: DriveAnswer = { result: false };
  private refusedAt = Number.NEGATIVE_INFINITY;
  private endedMotion = -1; // of the controls that the refusal has released: it is shown until they are
  private droveAt = Number.NEGATIVE_INFINITY; // the newest answer by which this page moved the robot
  private showCommand: (command: Deflection) => void = () => {}; // on the stick
  private readonly pause = new Pause();

  constructor(
    private readonly fleet: Fleet,
    private readonly connection: Connection,
    private readonly canDrive: () => boolean,
  ) {
    this.connectSlider("linear", "m/s", 2, 0.2);
    this.connectSlider("angular", "rad/s", 1, 1);
    find("#take-over").addEventListener("click", () => this.takeOver());
    setInterval(() => this.tick(), TICK_MS);
    for (const event of [...LOST, "pagehide"]) addEventListener(event, () => this.driving.releaseAll());
    document.addEventListener("visibilitychange", () => document.hidden && this.driving.releaseAll());
  }

  /** `stop` is called for Space and the gamepad's button, `lock` for L and Escape. */
  connectInputs(stop: () => void, lock: () => void): void {
    this.showCommand = connectJoystick(find("#joystick"), this.driving);
    connectKeys(this.driving, stop, lock);
    connectGamepad(find("#gamepad"), this.driving, stop);
  }

  /** The driver of this robot as a text; null without one. */
  driver(robot: RobotView): string | null {
    if (robot.holder === null) return null;
    const isLate = performance.now() - this.droveAt >= AFTERGLOW_MS; // a client of another daemon may have the same name
    const isMine = robot.name === this.target?.name && robot.holder === this.name && !isLate;
    return isMine ? "you" : driverText(robot.holder, robot.holder_address);
  }

  /**
   * Keep the stick active while another source drives; after other refusals it must be released first. A refused zero
   * is not shown: another source drives, and the user wants nothing.
   * The refusal of a command of an earlier motion does not end this motion: its own commands are answered too.
   */
  answered(answer: DriveAnswer): void {
    const command = this.unanswered.shift();
    if (answer.result) {
      this.name = answer.client ?? null;
      if (command?.isZero === false) this.droveAt = performance.now();
      if (command?.takesOver) this.takesOver = false;
      if (command?.motion === this.motion) this.epoch ??= answer.epoch ?? null;
      return;
    }
    const isEarlier = command !== undefined && command.motion !== this.motion;
    if (answer.kind !== HELD && !isEarlier) {
      this.driving.releaseAll();
      this.endedMotion = this.driving.motion;
    }
    if (answer.kind === HELD && command?.isZero) return;
    this.refusal = answer;
    this.refusedAt = performance.now();
    this.show();
  }

  /** Note that the connection changed: earlier commands will not be answered. */
  forget(): void {
    this.driving.releaseAll();
    this.takesOver = false;
    this.unanswered = [];
  }

  show(): void {
    const { robot } = this.fleet;
    if (robot?.name !== this.target?.name || robot?.velocity_topic !== this.target?.velocity_topic) {
      this.driving.releaseAll(); // the zeros are sent to the robot that was driven
      this.takesOver = false;
      this.endedMotion = -1;
    }
    this.target = robot;
    const isSideways = robot !== undefined && hasSideways(robot);
    this.driving.hasSideways = isSideways;
    this.driving.turnsInPlace = robot === undefined || turnsInPlace(robot);
    find("#drive").dataset["turns"] = this.driving.turnsInPlace ? "in place" : "moving";
    for (const each of ["#strafe", "#command-left", "#drive .sideways"]) find(each).hidden = !isSideways;
    const isHeld = robot !== undefined && this.isHeldByEqual(robot);
    if (!isHeld) this.takesOver = false;
    find("#take-over").hidden = !isHeld || this.takesOver;
    if (robot?.locked || robot?.connected === false || !this.canDrive()) this.driving.releaseAll();
    find("#read-only").hidden = this.canDrive() || robot?.locked === true;
    for (const slider of document.querySelectorAll<HTMLInputElement>("#drive input"))
      slider.disabled = !this.canDrive();
    const [state, text] = this.describe(robot);
    find("#drive").dataset.state = state;
    setText(find("#drive-state"), text);
    find("#drive-state").title = text;
  }

  /** The next controls that are held take the robot over. What is held now must be released first. */
  private takeOver(): void {
    this.driving.releaseAll();
    this.takesOver = true;
    this.refusedAt = Number.NEGATIVE_INFINITY;
    this.show();
  }

  /** Whether another source of this page's priority keeps the robot until it lets go, and this page may drive. */
  private isHeldByEqual(robot: RobotView): boolean {
    if (!this.canDrive() || !robot.connected || robot.locked || robot.played) return false;
    return robot.holder !== null && robot.priority === TELEOP_PRIORITY && this.driver(robot) !== "you";
  }

  private get isRefused(): boolean {
    const isReleased = !this.driving.isBarred || this.driving.motion !== this.endedMotion;
    return performance.now() - this.refusedAt < REFUSED_MS || !isReleased;
  }

  private describe(robot: RobotView | undefined): [state: string, text: string] {
    if (this.connection.state !== "open") return ["gone", "No connection"];
    const { missed } = this.fleet;
    if (missed !== null) return ["gone", `Choose a robot: ${missed} is not listed any longer`];
    if (robot === undefined) return ["idle", "No robot yet"];
    if (!robot.connected) return ["gone", `${robot.name} is not connected`];
    if (!this.canDrive()) return ["read", "This token has the role read"];
    if (!this.fleet.isHeard) return ["silent", `No data about ${robot.name} for ${ageText(this.fleet.age_s(robot))}`];
    if (this.fleet.isSilent(robot)) {
      return ["silent", `${robot.name}: silent for ${ageText(this.fleet.age_s(robot))}`];
    }
    if (robot.locked) return ["locked", `${robot.name} is locked`];
    if (robot.played) return ["other", "A recording: it cannot be driven"];
    if (this.isRefused && !(this.refusal.kind === HELD && robot.holder !== null))
      return ["refused", refusalText(this.refusal, robot.name)];
    if (robot.unreachable) return ["refused", `${robot.name} cannot receive: ${robot.unreachable}`];
    if (this.driving.isImpossible) return ["other", "Cannot turn in place: go forward, too"];
    const driver = this.driver(robot);
    if (driver === "you") return ["driving", "You drive"];
    if ((robot.priority ?? 0) > TELEOP_PRIORITY) return ["other", `${driver} drives with a higher priority`];
    if (this.takesOver) return ["other", `Hold the stick to take over from ${driver}`];
    if (this.isHeldByEqual(robot)) return ["other", `Driven by ${driver} until it lets go`];
    if (driver !== null) return ["other", `${driver} drives: your stick takes over`];
    return ["idle", "Ready: no driver"];
  }

  private tick(): void {
    const isBlind = SEEN.some((source) => this.driving.holds(source)) && !isStickShown();
    if (this.pause.isLong() || isBlind)
      this.driving.releaseAll(); // after a pause the robot has stopped, and releases may have been missed
    else this.driving.tick();
    const command = this.canDrive() ? this.driving.velocity() : STANDING;
    setText(find("#command-linear"), digits(command.linear_m_s, 2));
    setText(find("#command-angular"), digits(command.angular_rad_s, 2));
    setText(find("#command-left output"), digits(command.linear_y_m_s, 2));
    const { linear_m_s, angular_rad_s } = this.driving.limits;
    this.showCommand({
      forward: command.linear_m_s / linear_m_s,
      turn: command.angular_rad_s / angular_rad_s,
      left: command.linear_y_m_s / linear_m_s,
    });
  }

  /** Send a velocity, or drop it and return false. A zero waits for no answer, and needs no right to drive. */
  private send(velocity: Velocity): boolean {
    const now = performance.now();
    const isMoving = !isZero(velocity);
    const { motion } = this.driving;
    if (motion !== this.motion) this.epoch = null;
    this.motion = motion;
    if (!this.target?.connected) return false;
    if (isMoving && (!this.canDrive() || now - (this.unanswered[0]?.at ?? now) > UNANSWERED_MS)) return false;
    const takesOver = this.takesOver && isMoving;
    const isSent = this.connection.drive({
      robot: this.target.name,
      linear: velocity.linear_m_s,
      linear_y: velocity.linear_y_m_s ?? 0,
      angular: velocity.angular_rad_s,
      priority: TELEOP_PRIORITY,
      epoch: this.epoch,
      take_over: takesOver,
      sent_s: now / 1000,
    });
    if (isSent) this.unanswered.push({ at: now, motion, takesOver, isZero: !isMoving });
    return isSent;
  }

  /** Apply a new top speed. It changes the velocity of held controls and moves nothing by itself. */
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

/** The daemon tells programs to send a zero. */
function refusalText({ kind, by, reason }: DriveAnswer, robot: string): string {
  return kind === DISARMED && by ? `${robot}: ${by}. Release the stick, then hold it again` : (reason ?? "");
}

/** Whether the page was paused for longer than a command lasts, by its clock or by the time of day. */
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
