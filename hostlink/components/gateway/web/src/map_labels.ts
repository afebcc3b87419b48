/** Places of the names on the map, so that none overlaps another name or a robot. Pure. */

export interface Label {
  x: number; // of the named robot
  y: number;
  radius: number;
  sizes: Size[]; // of the possible texts, the best first
}

interface Size {
  text: string;
  width: number;
  height: number;
}

export interface Box {
  left: number;
  top: number;
  right: number;
  bottom: number;
}

export interface Placed<L extends Label> {
  label: L;
  text: string;
  left: number;
  top: number;
}

const GAP_PX = 2;

/** Place the first labels first, none over `others`. A label without a free place near its robot is left out. */
export function placeLabels<L extends Label>(labels: L[], width: number, height: number, others: Box[]): Placed<L>[] {
  const robots = labels.map(({ x, y, radius }) => ({
    left: x - radius,
    top: y - radius,
    right: x + radius,
    bottom: y + radius,
  }));
  const taken: Box[] = [...others, ...robots];
  const placed: Placed<L>[] = [];
  for (const label of labels) {
    const isFree = (box: Box) => isInside(box, width, height) && !taken.some((one) => overlap(one, box));
    for (const size of label.sizes) {
      const found = places(label, size).find(isFree);
      if (found === undefined) continue;
      taken.push(found);
      placed.push({ label, text: size.text, left: found.left + GAP_PX, top: found.top + GAP_PX });
      break;
    }
  }
  return placed;
}

/** Below, above, right, left, and the corners. */
function places({ x, y, radius }: Label, { width, height }: Size): Box[] {
  const [w, h] = [width + 2 * GAP_PX, height + 2 * GAP_PX];
  const corners: [left: number, top: number][] = [
    [x - w / 2, y + radius],
    [x - w / 2, y - radius - h],
    [x + radius, y - h / 2],
    [x - radius - w, y - h / 2],
    [x, y + radius],
    [x - w, y + radius],
    [x, y - radius - h],
    [x - w, y - radius - h],
  ];
  return corners.map(([left, top]) => ({ left, top, right: left + w, bottom: top + h }));
}

function isInside({ left, top, right, bottom }: Box, width: number, height: number): boolean {
  return left >= 0 && top >= 0 && right <= width && bottom <= height;
}

function overlap(one: Box, other: Box): boolean {
  return one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;
}
