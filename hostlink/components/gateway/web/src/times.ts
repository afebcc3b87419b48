/** Times of day as people read them: local, with the offset from UTC, because files and other programs use UTC. */

/** The offset at a time, as `+02:00`. */
export function offsetOf(date: Date): string {
  const minutes = -date.getTimezoneOffset();
  const [hours, rest] = [Math.floor(Math.abs(minutes) / 60), Math.abs(minutes) % 60];
  return `${minutes < 0 ? "−" : "+"}${[hours, rest].map((part) => String(part).padStart(2, "0")).join(":")}`;
}

export function dateText(date: Date): string {
  return `${date.toLocaleString([], { hour12: false })} ${offsetOf(date)}`;
}

export function timeText(date: Date): string {
  return `${date.toLocaleTimeString([], { hour12: false })} ${offsetOf(date)}`;
}
