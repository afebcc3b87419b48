/** How long events are on their way here, by when the daemon sent them: the quickest of the last minutes took no time. Pure. */

const BEAT_MS = 300; // the daemon writes at least so often
const KEPT_MS = 120_000; // then a clock that runs a little faster has not made a difference

export class Delay {
  private quickest: { offset_ms: number; at_ms: number } | null = null; // from the daemon's clock to the page's
  private before_ms = Number.POSITIVE_INFINITY; // the quickest offset of the time before
  private last_ms = 0;
  private noted_ms = 0;

  /** Another stream begins. */
  begin(now_ms: number): void {
    this.quickest = null;
    this.before_ms = Number.POSITIVE_INFINITY;
    this.last_ms = 0;
    this.noted_ms = now_ms;
  }

  /** All that the daemon had sent by then has come; undefined: nothing was on its way. */
  note(sent_s: string | undefined, now_ms: number): void {
    this.noted_ms = now_ms;
    this.last_ms = 0;
    if (sent_s === undefined) return;
    const offset_ms = now_ms - 1000 * Number(sent_s);
    if (this.quickest !== null && now_ms - this.quickest.at_ms > KEPT_MS) {
      this.before_ms = this.quickest.offset_ms;
      this.quickest = null;
    }
    if (this.quickest === null) this.quickest = { offset_ms, at_ms: now_ms };
    this.quickest.offset_ms = Math.min(this.quickest.offset_ms, offset_ms);
    this.last_ms = offset_ms - Math.min(this.quickest.offset_ms, this.before_ms);
  }

  /** How old what came last is: what comes now has not come whole. */
  at_ms(now_ms: number): number {
    return Math.max(this.last_ms, now_ms - this.noted_ms - BEAT_MS);
  }
}
