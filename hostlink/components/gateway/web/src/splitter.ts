/**
 * An edge that gives a panel or a column another size: drag it with mouse or finger, or focus it and press the arrow keys.
 * A double click or Enter restores the size of the layout.
 */

import { make } from "./dom";

const STEP_PX = 16; // of an arrow key
const WAYS = {
  x: { ArrowLeft: -1, ArrowRight: 1 },
  y: { ArrowUp: -1, ArrowDown: 1 },
} as Record<"x" | "y", Record<string, number>>;

export interface Splitting {
  label: string;
  axis: "x" | "y"; // in which it moves
  isBefore?: boolean; // whether it stands before what it sizes, which then shrinks when it moves forwards
  size: () => number;
  bounds: () => [least: number, most: number];
  resize: (size: number | null) => void; // null: the size of the layout
}

export function makeSplitter({ label, axis, isBefore = false, size, bounds, resize }: Splitting): HTMLElement {
  const splitter = make("div", {
    role: "separator",
    class: `splitter along-${axis}`,
    tabindex: "0",
    "aria-orientation": axis === "x" ? "vertical" : "horizontal",
    "aria-label": label,
    "aria-valuenow": "0",
    title: `${label}: drag, or press the arrow keys. A double click or Enter resets it.`,
  });
  const place = (event: PointerEvent) => (isBefore ? -1 : 1) * (axis === "x" ? event.clientX : event.clientY);
  let grabbed: { place: number; size: number } | null = null;
  const show = () => {
    const [least, most] = bounds();
    splitter.setAttribute("aria-valuemin", String(Math.round(least)));
    splitter.setAttribute("aria-valuemax", String(Math.round(most)));
    splitter.setAttribute("aria-valuenow", String(Math.round(size())));
  };
  const change = (to: number | null) => {
    const [least, most] = bounds();
    resize(to === null ? null : Math.max(least, Math.min(most, to)));
    show();
  };
  splitter.addEventListener("focus", show);
  splitter.addEventListener("mousedown", (event) => event.preventDefault()); // no focus: the arrow keys go on driving
  splitter.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    grabbed = { place: place(event), size: size() };
    splitter.setPointerCapture(event.pointerId);
  });
  splitter.addEventListener("pointermove", (event) => {
    if (grabbed !== null) change(grabbed.size + place(event) - grabbed.place);
  });
  splitter.addEventListener("lostpointercapture", () => (grabbed = null));
  splitter.addEventListener("dblclick", () => change(null));
  splitter.addEventListener("keydown", (event) => {
    const way = WAYS[axis][event.code];
    if (event.code === "Enter") change(null);
    else if (way !== undefined) change(size() + (isBefore ? -way : way) * STEP_PX);
    else return;
    event.preventDefault(); // an arrow would scroll the column
  });
  return splitter;
}
