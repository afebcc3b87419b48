/**
 * Hold to drive: held controls are summed, sent repeatedly while held, and followed by zeros. Without element or
 * clock: the page calls `tick`.
 */

import type { Velocity } from "./views";

export const TICK_MS = 80; // more than ten commands a second, as robot bases expect
const ZEROS = 3; // zeros after a release, because a radio may lose one

export type Source = "joystick" | "keys" | "gamepad" | "step";

/** Fractions of the full speeds, -1 to 1: forward, and counter-clockwise. */
export interface Deflection {
  forward: number;
  turn: number;
}

export class Driving {
  /** Full speeds. A change applies to held controls and moves nothing by itself. */
  limits: Velocity = { linear_m_s: 0.2, angular_rad_s: 1 };

  private held = new Map<Source, Deflection>();
  private barred = new Set<Source>(); // must be released before it drives again
  private zeros = 0;

  /** `send` sends a velocity now, or drops it. */
  constructor(private readonly send: (velocity: Velocity) => void) {}

  get isHeld(): boolean {
    return this.held.size > 0;
  }

  holds(source: Source): boolean {
    return this.held.has(source);
  }

  hold(source: Source, deflection: Deflection): void {
    if (this.barred.has(source)) return;
    const isNew = !this.held.has(source);
    this.held.set(source, deflection);
    if (isNew) this.tick();
  }

  release(source: Source): void {
    this.barred.delete(source);
    if (!this.held.delete(source)) return;
    if (!this.isHeld) this.zeros = ZEROS;
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
    for (const source of this.held.keys()) this.barred.add(source);
    if (this.isHeld) this.zeros = ZEROS;
    this.held.clear();
    while (this.zeros > 0) this.tick(); // there may be no later tick
  }

  /** The present command, within the full speeds. */
  velocity(): Velocity {
    let forward = 0;
    let turn = 0;
    for (const deflection of this.held.values()) {
      forward += deflection.forward;
      turn += deflection.turn;
    }
    return {
      linear_m_s: clamp(forward) * this.limits.linear_m_s,
      angular_rad_s: clamp(turn) * this.limits.angular_rad_s,
    };
  }

  tick(): void {
    if (this.isHeld) {
      this.send(this.velocity());
    } else if (this.zeros > 0) {
      this.zeros -= 1;
      this.send({ linear_m_s: 0, angular_rad_s: 0 });
    }
  }
}

function clamp(part: number): number {
  return Math.max(-1, Math.min(1, part));
}
