/** Long names of robots: the part that distinguishes them stays visible, and the rest is shortened first. */

import { make } from "./dom";

const SEPARATOR = "_\\-./: ";
const SHORT = 4; // characters: shortening so few saves nothing, and their least width would be a gap in the name
const TAIL = new RegExp(`[${SEPARATOR}]?[^${SEPARATOR}]{1,12}$`); // the last word of a name
const AFTER_SEPARATOR = new RegExp(`[^${SEPARATOR}]*$`);

/** The words with which every name begins; empty for a single name. */
export function commonPrefix(names: readonly string[]): string {
  const [first = "", ...others] = names;
  if (others.length === 0) return "";
  let length = first.length;
  for (const other of others) {
    while (!other.startsWith(first.slice(0, length))) length -= 1;
  }
  return first.slice(0, length).replace(AFTER_SEPARATOR, "");
}

/** Parts of a name: common to all robots, then of some of them, then the last word. Together they are the name. */
export function partsOf(name: string, prefix: string): [head: string, middle: string, tail: string] {
  const head = name.startsWith(prefix) ? prefix : "";
  const rest = name.slice(head.length);
  const tail = TAIL.exec(rest)?.[0] ?? rest.slice(-8);
  return [head, rest.slice(0, rest.length - tail.length), tail];
}

/** Show a name after a text; `style/names.css` shortens the parts in their order. */
export function showName(element: HTMLElement, name: string, prefix: string, before = ""): void {
  const parts = partsOf(name, prefix);
  const key = [before, ...parts].join("\n");
  if (element.dataset.name === key) return;
  element.dataset.name = key;
  element.classList.add("name");
  const [head, middle, tail] = parts;
  element.replaceChildren(
    ...(before ? [make("span", { class: "name-before" }, before)] : []),
    ...(head ? [make("span", { class: classOf(head, "name-shared") }, head)] : []),
    ...(middle ? [make("span", { class: classOf(middle, "name-middle") }, middle)] : []),
    make("span", { class: "name-last" }, tail),
  );
}

function classOf(part: string, shortened: string): string {
  return part.length > SHORT ? shortened : "name-short";
}

/** Show a text that is not a name where a name may have been. */
export function showText(element: HTMLElement, text: string): void {
  if (element.dataset.name === text) return;
  element.dataset.name = text;
  element.classList.remove("name");
  element.textContent = text;
}
