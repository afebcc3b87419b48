/** A colour for each robot, the same in the list and on the map while the page is open. */

import { computedColour } from "./theme";

const HUES = [255, 335, 185, 295, 145, 70, 225, 15, 110]; // far apart; the first is the accent colour
const TURN = 137.508; // golden angle: the next hue is far from all earlier ones

const indices = new Map<string, number>();

/** In the order in which robots are first seen. */
export function robotColour(name: string): string {
  const index = indices.get(name) ?? indices.size;
  indices.set(name, index);
  const hue = HUES[index] ?? Math.round(((index * TURN) % 360) * 10) / 10;
  const isOther = index >= HUES.length && index % 2 === 1;
  return isOther
    ? `light-dark(oklch(0.61 0.13 ${hue}), oklch(0.68 0.12 ${hue}))`
    : `light-dark(oklch(0.51 0.16 ${hue}), oklch(0.75 0.13 ${hue}))`;
}

/** For a canvas. */
export function robotPaint(name: string): string {
  return computedColour(robotColour(name));
}
