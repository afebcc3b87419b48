/** A text of a few lines. When it is longer, a button next to it shows all of it: no reason is cut without a way to it. */

import { make, setText } from "./dom";

const WHOLE = "whole"; // class of a text without a limit of lines

/** The style sheet limits the lines of the text; `.whole` lifts the limit. */
export function makeExpandable(text: HTMLElement): void {
  const button = make("button", { type: "button", class: "show-all", "aria-expanded": "false", hidden: "" }, "more");
  const show = (isWhole: boolean) => {
    text.classList.toggle(WHOLE, isWhole);
    setText(button, isWhole ? "less" : "more");
    button.setAttribute("aria-expanded", String(isWhole));
  };
  const measure = () => {
    const wasWhole = text.classList.contains(WHOLE);
    text.classList.remove(WHOLE);
    const isCut = text.scrollHeight > text.clientHeight + 1;
    button.hidden = !isCut;
    show(wasWhole && isCut);
  };
  button.addEventListener("click", () => show(!text.classList.contains(WHOLE)));
  new MutationObserver(measure).observe(text, { childList: true, characterData: true, subtree: true });
  new ResizeObserver(measure).observe(text.parentElement ?? text);
  text.after(button);
}

/** Whether the user reads a text that was expanded. */
export function isExpanded(text: HTMLElement): boolean {
  return text.classList.contains(WHOLE);
}
