/**
 * Hold to drive: held controls are summed, sent repeatedly while held, and followed by zeros. Without element or
 * clock: the page calls `tick`.
 */

import type { Velocity } from "./views";

export const TICK_MS = 80; // more than ten commands a second, as robot bases expect
const ZEROS = 3; // zeros after a release, because a radio may lose one

export const STANDING: Required<Velocity> = { linear_m_s: 0, linear_y_m_s: 0, angular_rad_s: 0 };

export type Source = "joystick" | "keys" | "gamepad" | "step";

const LEAST_FORWARD = 0.08; // a finger that pulls the stick sideways means no more

/** Fractions of the full speeds, -1 to 1: forward, counter-clockwise, and to the left. */
export interface Deflection {
  forward: number;
  turn: number;
  left?: number;
}

export class Driving {
  /** Full speeds. A change applies to held controls and moves nothing by itself. */
  limits = { linear_m_s: 0.2, angular_rad_s: 1 };
  /** Of the robot's drive. What it cannot do is not sent. */
  hasSideways = false;
  turnsInPlace = true;

  private held = new Map<Source, Deflection>();
  private barred = new Set<Source>(); // must be released before it drives again
  private zeros = 0;
  private motions = 0;

  /** `send` sends a velocity now, or drops it and returns false. */
  constructor(private readonly send: (velocity: Velocity) => boolean) {}

  /** Number of the motion: it increases when controls are first held, and when all are released. */
  get motion(): number {
    return this.motions;
  }

  get isHeld(): boolean {
    return this.held.size > 0;
  }

  /** Whether a control must be released before it drives again. */
  get isBarred(): boolean {
    return this.barred.size > 0;
  }

  holds(source: Source): boolean {
    return this.held.has(source);
  }

  hold(source: Source, deflection: Deflection): void {
    if (this.barred.has(source)) return;
    const isNew = !this.held.has(source);
    if (!this.isHeld) this.motions += 1;
    this.held.set(source, deflection);
    if (isNew) this.tick();
  }

  release(source: Source): void {
    this.barred.delete(source);
    if (!this.held.delete(source)) return;
    if (!this.isHeld) this.motions += 1;
    this.tick();
  }

  /** Treat a control as released until it is. Return false if that was so before. */
  bar(source: Source): boolean {
    if (this.barred.has(source)) return false;
    this.release(source);
    this.barred.add(source);
    return true;
  }

  /** Treat all controls as released, those that are held until they are. */
  releaseAll(): void {
    if (this.isHeld) this.motions += 1;
    for (const source of this.held.keys()) this.barred.add(source);
    this.held.clear();
    while (this.zeros > 0) this.tick(); // there may be no later tick
  }

  /** Whether a turn in place is held that the robot cannot do: nothing is sent for it. */
  get isImpossible(): boolean {
    const { forward, turn } = this.sum();
    return !this.turnsInPlace && turn !== 0 && Math.abs(forward) < LEAST_FORWARD;
  }

  /** The present command, within the full speeds; forward and sideways together are within the top speed. */
  velocity(): Required<Velocity> {
    if (this.isImpossible) return STANDING;
    const { forward, turn, left } = this.sum();
    const linear_m_s = this.limits.linear_m_s / Math.max(1, Math.hypot(forward, left));
    return {
      linear_m_s: forward * linear_m_s,
      linear_y_m_s: left * linear_m_s,
      angular_rad_s: turn * this.limits.angular_rad_s,
    };
  }

  /** Send what is held; after what was sent, zeros. */
  tick(): void {
    if (this.isHeld && !this.isImpossible) {
      if (this.send(this.velocity())) this.zeros = ZEROS;
    } else if (this.zeros > 0) {
      this.zeros -= 1;
      this.send(STANDING);
    }
  }

  private sum(): Required<Deflection> {
    const held = [...this.held.values()];
    const sum = (part: keyof Deflection) => clamp(held.reduce((total, each) => total + (each[part] ?? 0), 0));
    return { forward: sum("forward"), turn: sum("turn"), left: this.hasSideways ? sum("left") : 0 };
  }
}

/** Whether a velocity moves nothing. */
export function isZero({ linear_m_s, linear_y_m_s, angular_rad_s }: Velocity): boolean {
  return linear_m_s === 0 && (linear_y_m_s ?? 0) === 0 && angular_rad_s === 0;
}

function clamp(part: number): number {
  return Math.max(-1, Math.min(1, part));
}
