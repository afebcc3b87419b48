/** What is open over the page: Escape closes it before it locks a robot. Without a clock. */

const closers: (() => boolean)[] = [];

/** `close` closes something and returns true, or returns false because it was not open. What is added later lies above. */
export function addCloser(close: () => boolean): void {
  closers.unshift(close);
}

/** Close what lies above everything else. Return false if nothing was open. */
export function closeTop(): boolean {
  return closers.some((close) => close());
}
