/** The notice line: the most severe of all present problems. */

import { find, setText } from "./dom";

/** The most severe first. */
const KINDS = ["stop", "connection", "refused", "robot", "done"] as const;
export type Kind = (typeof KINDS)[number];

const texts = new Map<Kind, string>();
const timers = new Map<Kind, number>();

/** Show or (null) remove a notice. `for_ms`: it is removed after this time. */
export function notice(kind: Kind, text: string | null, for_ms?: number): void {
  clearTimeout(timers.get(kind));
  if (text === null) texts.delete(kind);
  else texts.set(kind, text);
  if (text !== null && for_ms !== undefined)
    timers.set(
      kind,
      setTimeout(() => notice(kind, null), for_ms),
    );
  const worst = KINDS.find((each) => texts.has(each));
  const box = find("#notice");
  box.hidden = worst === undefined;
  box.dataset.kind = worst ?? "";
  setText(find("#notice p"), worst === undefined ? "" : (texts.get(worst) ?? ""));
}
