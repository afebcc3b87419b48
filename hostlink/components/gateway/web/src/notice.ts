/** The notice line: the most severe of all present problems. */

import { find, setText } from "./dom";
import { isExpanded } from "./expandable";

/** The most severe first. */
const KINDS = ["stop", "connection", "refused", "robot", "done"] as const;
export type Kind = (typeof KINDS)[number];

const texts = new Map<Kind, string>();
const timers = new Map<Kind, number>();

const READ_MS = 1000;

/** Show or (null) remove a notice. `for_ms`: it is removed after this time, unless the user has expanded it. */
export function notice(kind: Kind, text: string | null, for_ms?: number): void {
  clearTimeout(timers.get(kind));
  if (text === null) texts.delete(kind);
  else texts.set(kind, text);
  if (text !== null && for_ms !== undefined) removeAfter(kind, for_ms);
  const worst = KINDS.find((each) => texts.has(each));
  const box = find("#notice");
  box.hidden = worst === undefined;
  box.dataset.kind = worst ?? "";
  setText(find("#notice p"), worst === undefined ? "" : (texts.get(worst) ?? ""));
}

/** Show a notice for as long as this is called again and again, and then for `for_ms`; another one of its kind stays. */
export function keepNotice(kind: Kind, text: string, for_ms: number): void {
  const shown = texts.get(kind);
  if (shown === undefined || shown === text) notice(kind, text, for_ms);
}

function removeAfter(kind: Kind, for_ms: number): void {
  const end = () => (isExpanded(find("#notice p")) ? removeAfter(kind, READ_MS) : notice(kind, null));
  timers.set(kind, setTimeout(end, for_ms));
}
