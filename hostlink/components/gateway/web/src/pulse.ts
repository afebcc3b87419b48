/** How long a robot has been silent by this page's clock, and whether that is unusual for it. Pure. */

const LEAST_MS = 330; // three poses of the usual ten a second; with the daemon's tick it is shown within 0.5 s
const SINCE_MS = 200; // the daemon writes at least every 300 ms
const USUAL_GAPS = 3; // a radio delays one or two messages, not three
const [KEPT, ENOUGH] = [15, 5]; // gaps; their median is robust against a few long ones
const UNKNOWN_MS = 3000; // a live device sends something every 2.5 s: docs/protocol.md

export class Pulse {
  private heardAt_ms: number;
  private count = -1;
  private gap_ms: number | null = null;
  private readonly gaps_ms: number[] = []; // the last gaps as observed here

  constructor(now_ms: number) {
    this.heardAt_ms = now_ms;
  }

  /** Add a view of the robot: number of its messages, age of the last, messages a second; null: unknown. */
  note(count: number, age_s: number, rate_hz: number | null, now_ms: number): void {
    if (count === this.count) return;
    const heardAt_ms = now_ms - age_s * 1000;
    if (count > this.count && this.count >= 0) this.learn((heardAt_ms - this.heardAt_ms) / (count - this.count));
    this.count = count;
    this.heardAt_ms = heardAt_ms;
    if (this.gaps_ms.length >= ENOUGH) this.gap_ms = median(this.gaps_ms);
    else if (rate_hz !== null && rate_hz > 0) this.gap_ms = 1000 / rate_hz;
  }

  private learn(gap_ms: number): void {
    this.gaps_ms.push(gap_ms);
    if (this.gaps_ms.length > KEPT) this.gaps_ms.shift();
  }

  age_ms(now_ms: number): number {
    return Math.max(0, now_ms - this.heardAt_ms);
  }

  /**
   * A robot without data is not silent. Nor is one whose last message is newer than the daemon's last event: then the
   * daemon or the network is late.
   */
  isSilent(now_ms: number, daemonHeardAt_ms: number): boolean {
    if (this.count < 0 || daemonHeardAt_ms < this.heardAt_ms + SINCE_MS) return false;
    return this.age_ms(now_ms) > (this.gap_ms === null ? UNKNOWN_MS : Math.max(LEAST_MS, USUAL_GAPS * this.gap_ms));
  }
}

function median(values: number[]): number {
  const sorted = [...values].sort((one, other) => one - other);
  return sorted[Math.floor(sorted.length / 2)] ?? UNKNOWN_MS;
}
