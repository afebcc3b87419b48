/** The part of the floor that a canvas shows: conversion of metres and pixels, fitting, zooming, panning. */

const MARGIN = 1.1;
const BODY_PX = 30; // a robot at the edge, with its ring
const INSETS_PX = { top: 44, bottom: 34 }; // for the buttons and the scale, if there is room
const LOW_PX = 200; // a lower map has no insets
const LEAST_SPAN_M = 1.6;
const PX_PER_M = { min: 1e-4, max: 2000 };
const EASE = 0.2; // fraction of the way, in each frame

interface Box {
  left: number;
  right: number;
  bottom: number;
  top: number;
}

export class Viewport {
  x_m = 0; // at the centre
  y_m = 0;
  pxPerM = 100;
  isFitting = true;
  width = 1;
  height = 1;

  toPx(x_m: number, y_m: number): [number, number] {
    return [this.width / 2 + (x_m - this.x_m) * this.pxPerM, this.height / 2 - (y_m - this.y_m) * this.pxPerM];
  }

  toM(x: number, y: number): [number, number] {
    return [this.x_m + (x - this.width / 2) / this.pxPerM, this.y_m - (y - this.height / 2) / this.pxPerM];
  }

  /** Move towards showing the whole box; return true while moving. */
  fit(box: Box, isAtOnce: boolean): boolean {
    const spanX = Math.max(LEAST_SPAN_M, (box.right - box.left) * MARGIN);
    const spanY = Math.max(LEAST_SPAN_M, (box.top - box.bottom) * MARGIN);
    const { top, bottom } = this.height > LOW_PX ? INSETS_PX : { top: 0, bottom: 0 };
    const free = { width: this.width - 2 * BODY_PX, height: this.height - top - bottom - 2 * BODY_PX };
    const pxPerM = Math.max(PX_PER_M.min, Math.min(free.width / spanX, free.height / spanY));
    const wanted = {
      x_m: (box.left + box.right) / 2,
      y_m: (box.bottom + box.top) / 2 + (top - bottom) / 2 / pxPerM,
      pxPerM,
    };
    const offPx = Math.hypot(wanted.x_m - this.x_m, wanted.y_m - this.y_m) * this.pxPerM;
    if (offPx <= 0.5 && Math.abs(wanted.pxPerM / this.pxPerM - 1) <= 0.002) return false; // small differences are not redrawn
    const ease = isAtOnce ? 1 : EASE;
    this.x_m += (wanted.x_m - this.x_m) * ease;
    this.y_m += (wanted.y_m - this.y_m) * ease;
    this.pxPerM += (wanted.pxPerM - this.pxPerM) * ease;
    return !isAtOnce;
  }

  /** Zoom around a point of the canvas, which stays in place. */
  zoom(factor: number, x = this.width / 2, y = this.height / 2): void {
    const [x_m, y_m] = this.toM(x, y);
    this.isFitting = false;
    this.pxPerM = Math.max(PX_PER_M.min, Math.min(PX_PER_M.max, this.pxPerM * factor));
    const [newX_m, newY_m] = this.toM(x, y);
    this.x_m += x_m - newX_m;
    this.y_m += y_m - newY_m;
  }

  pan(dx: number, dy: number): void {
    this.isFitting = false;
    this.x_m -= dx / this.pxPerM;
    this.y_m += dy / this.pxPerM;
  }
}

/** The bounding box of points. */
export function boxAround(points: Iterable<{ x: number; y: number }>): Box {
  const box = { left: Number.POSITIVE_INFINITY, right: -Infinity, bottom: Number.POSITIVE_INFINITY, top: -Infinity };
  for (const { x, y } of points) {
    box.left = Math.min(box.left, x);
    box.right = Math.max(box.right, x);
    box.bottom = Math.min(box.bottom, y);
    box.top = Math.max(box.top, y);
  }
  return Number.isFinite(box.left) ? box : { left: 0, right: 0, bottom: 0, top: 0 };
}

/** The smallest of 1, 2, 5, 10, ... that is not below. */
export function roundUp(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  return ([1, 2, 5].find((step) => step * power >= value * 0.999) ?? 10) * power;
}

/** A round length as a text. */
export function lengthText(length_m: number): string {
  if (length_m < 1) return `${Math.round(length_m * 100)} cm`;
  return length_m < 1000 ? `${length_m} m` : `${length_m / 1000} km`;
}
