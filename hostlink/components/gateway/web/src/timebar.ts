/** The controls of a timeline: pause, zoom, and a slider that moves the cursor with keys and fingers. */

import { make, setText } from "./dom";
import { makeButton } from "./widgets";
import type { Timeline } from "./timeline";

const STEPS = 400; // of the slider

/** `name` of the moved plots, for screen readers. */
export function makeTimebar(timeline: Timeline, name: string): HTMLElement {
  const pause = makeButton(timeline.isStored ? "All" : "Pause", () => {
    if (timeline.isLive) timeline.pause();
    else timeline.resume();
  });
  const nearer = makeButton("+", () => timeline.zoom(2), { "aria-label": `${name}: show less time` });
  const farther = makeButton("−", () => timeline.zoom(1 / 2), { "aria-label": `${name}: show more time` });
  const slider = make("input", { type: "range", min: "0", max: String(STEPS), "aria-label": `${name}: instant` });
  const instant = make("output", {});
  slider.addEventListener("input", () => {
    timeline.pause();
    const [begin, end] = timeline.range;
    timeline.point(begin + (slider.valueAsNumber / STEPS) * (end - begin));
  });
  const show = () => {
    const [begin, end] = timeline.range;
    const { cursor_s } = timeline;
    if (!timeline.isStored) {
      setText(pause, timeline.isLive ? "Pause" : "Live");
      pause.setAttribute("aria-label", timeline.isLive ? `${name}: pause` : `${name}: follow now`);
    }
    const text = cursor_s === null ? "" : timeline.label(cursor_s, 1);
    setText(instant, text);
    const place = cursor_s === null ? STEPS : Math.round(((cursor_s - begin) / (end - begin)) * STEPS);
    if (document.activeElement !== slider || cursor_s === null) slider.valueAsNumber = place;
    slider.setAttribute("aria-valuetext", text || timeline.label(end, 1));
  };
  if (timeline.isStored) pause.setAttribute("aria-label", `${name}: show all`);
  timeline.onChange(show);
  show();
  return make("div", { class: "timebar" }, pause, farther, nearer, slider, instant);
}
