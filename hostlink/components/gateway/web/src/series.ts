/** Samples over time in columns, the oldest first, bounded in seconds and in number. */

const MAX_SAMPLES = 12000;

export type Value = number | null; // null: the line breaks here
export type Row = [time_s: number, ...values: Value[]];

export class Series {
  times: number[] = [];
  columns: Value[][];

  /** `gap_s`: a line does not bridge a longer gap. */
  constructor(
    readonly width: number,
    private readonly keep_s = Number.POSITIVE_INFINITY,
    private readonly gap_s = Number.POSITIVE_INFINITY,
  ) {
    this.columns = Array.from({ length: width }, () => []);
  }

  add(...[time_s, ...values]: Row): void {
    const last = this.times.at(-1);
    if (last !== undefined && time_s <= last) return;
    if (last !== undefined && time_s - last > this.gap_s) this.append(last + this.gap_s / 2, []);
    this.append(time_s, values);
    const oldest = time_s - this.keep_s;
    let gone = this.times.length > MAX_SAMPLES ? MAX_SAMPLES / 100 : 0;
    while ((this.times[gone] ?? time_s) < oldest) gone += 1;
    if (gone > 0) for (const column of [this.times, ...this.columns]) column.splice(0, gone);
  }

  /** Add earlier samples in front. */
  prepend(rows: Row[]): void {
    const present = this.rows();
    const begin = this.times[0] ?? Number.POSITIVE_INFINITY;
    this.clear();
    for (const row of rows) if (row[0] < begin) this.add(...row);
    for (const row of present) this.add(...row);
  }

  clear(): void {
    this.times = [];
    this.columns = this.columns.map(() => []);
  }

  /** Index of the newest sample at or before this time; null without one. */
  indexAt(time_s: number): number | null {
    let [low, high] = [0, this.times.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if ((this.times[middle] ?? 0) <= time_s) low = middle + 1;
      else high = middle;
    }
    return low === 0 ? null : low - 1;
  }

  rows(): Row[] {
    return this.times.map((time_s, index) => [time_s, ...this.columns.map((column) => column[index] ?? null)]);
  }

  private append(time_s: number, values: Value[]): void {
    this.times.push(time_s);
    this.columns.forEach((column, index) => column.push(values[index] ?? null));
  }
}
