/** The order of the robots in the list: trouble first. Without elements or clock. */

/** The most severe first. driving: a source drives it. connected: idle. */
export const KINDS = ["gone", "silent", "locked", "driving", "connected"] as const;
export type Kind = (typeof KINDS)[number];

const SETTLE_MS = 5000; // how long a robot keeps the place of a trouble that has ended
const HOLD_MS = 4000; // how long no row moves after the user last aimed or scrolled
const FAULTY = 2.5; // rank of a robot whose device reports an error: after the locked ones
const WELL = KINDS.indexOf("driving"); // driven and idle robots are not separated: drivers come and go

export interface Placed {
  name: string;
  kind: Kind;
  isFaulty: boolean;
}

interface Place {
  kind: Kind;
  rank: number;
  at: number; // when it was last so severe
}

/**
 * A robot in trouble rises at once, and sinks some seconds after its trouble: a link that comes and goes moves no row
 * back and forth. While the user aims, no row moves at all, and new robots are at the end.
 */
export class FleetOrder {
  private readonly places = new Map<string, Place>();
  private order: string[] = [];
  private heldUntil = Number.NEGATIVE_INFINITY;

  /** Move no row for some seconds. */
  hold(now: number): void {
    this.heldUntil = now + HOLD_MS;
  }

  /** The kind by which a robot is placed. */
  kindOf(name: string): Kind | undefined {
    return this.places.get(name)?.kind;
  }

  /** Return the names in their order; robots of equal trouble are in the order of the argument. */
  update(robots: readonly Placed[], now: number): string[] {
    const isHeld = now < this.heldUntil;
    const names = new Set(robots.map(({ name }) => name));
    for (const name of this.places.keys()) if (!names.has(name)) this.places.delete(name);
    for (const robot of robots) {
      const place = this.places.get(robot.name);
      if (place === undefined || !isHeld) this.settle(robot, place, now);
    }
    if (isHeld) {
      const known = new Set(this.order);
      this.order = [...this.order.filter((name) => names.has(name)), ...[...names].filter((name) => !known.has(name))];
    } else {
      const rankOf = (name: string) => this.places.get(name)?.rank ?? WELL;
      this.order = [...names].sort((one, other) => rankOf(one) - rankOf(other));
    }
    return this.order;
  }

  private settle({ name, kind, isFaulty }: Placed, place: Place | undefined, now: number): void {
    const severity = KINDS.indexOf(kind);
    const isWorse = place === undefined || severity <= KINDS.indexOf(place.kind);
    const settled = isWorse || now - place.at >= SETTLE_MS ? { kind, at: now } : place;
    const rank = Math.min(WELL, KINDS.indexOf(settled.kind));
    this.places.set(name, { kind: settled.kind, at: settled.at, rank: isFaulty ? Math.min(rank, FAULTY) : rank });
  }
}
