/** Delay of events, from the times at which the daemon sent them. The quickest of the last minutes counts as no delay. Pure. */

const BEAT_MS = 300; // longest interval between the daemon's writes
const KEPT_MS = 120_000; // drift between the two clocks is negligible in this time

export class Delay {
  private quickest: { offset_ms: number; at_ms: number } | null = null; // from the daemon's clock to the page's
  private before_ms = Number.POSITIVE_INFINITY; // smallest offset of the previous period
  private last_ms = 0;
  private noted_ms = 0;

  /** Reset: a new stream begins. */
  begin(now_ms: number): void {
    this.quickest = null;
    this.before_ms = Number.POSITIVE_INFINITY;
    this.last_ms = 0;
    this.noted_ms = now_ms;
  }

  /** Note that everything the daemon sent until then has arrived; undefined: no time was sent. */
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

  /** Age of the newest event, including one that has not arrived completely. */
  at_ms(now_ms: number): number {
    return Math.max(this.last_ms, now_ms - this.noted_ms - BEAT_MS);
  }
}
