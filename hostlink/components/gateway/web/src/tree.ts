/** A message as a tree of its fields, updated in place. Its numbers can be selected for a plot. */

import { digits, make, setText } from "./dom";

const MAX_ROWS = 300;
const MAX_ITEMS = 12; // of an array; of a longer one the first are shown
const MAX_TEXT = 200;
const MAX_DEPTH = 8; // of the indentation

export type Keys = (string | number)[];

interface Row {
  path: string;
  keys: Keys;
  depth: number;
  name: string;
  text: string;
  isNumber: boolean;
}

interface Drawn {
  value: HTMLElement;
}

export class ValueTree {
  readonly element = make("ul", { class: "tree", "aria-label": "Values" });

  private shape = "";
  private drawn: Drawn[] = [];

  /** `onChoose`: a number was selected or deselected; it returns false without room. */
  constructor(private readonly onChoose: (path: string, keys: Keys, isOn: boolean) => boolean) {}

  show(message: unknown): void {
    const rows: Row[] = [];
    collect(message, [], "", 0, rows);
    const shape = rows.map(({ path, isNumber }) => `${path} ${isNumber}`).join("\n");
    if (shape === this.shape) {
      rows.forEach(({ text }, index) => {
        const value = this.drawn[index]?.value;
        if (value) setText(value, text);
      });
      return;
    }
    const chosen = new Set(
      [...this.element.querySelectorAll<HTMLInputElement>("input:checked")].map(({ value }) => value),
    );
    this.shape = shape;
    this.drawn = [];
    this.element.replaceChildren(...rows.map((row) => this.makeRow(row, chosen.has(row.path))));
  }

  private makeRow(row: Row, isChosen: boolean): HTMLElement {
    const value = make("b", {}, row.text);
    this.drawn.push({ value });
    const depth = `depth-${Math.min(row.depth, MAX_DEPTH)}`;
    if (!row.isNumber) return make("li", { class: depth }, make("span", {}, row.name), value);
    const box = make("input", { type: "checkbox", value: row.path, "aria-label": `Plot ${row.path}` });
    box.checked = isChosen;
    box.addEventListener("change", () => {
      if (!this.onChoose(row.path, row.keys, box.checked)) box.checked = false;
    });
    return make("li", { class: depth }, make("label", {}, box, make("span", {}, row.name)), value);
  }
}

/** The number at that path; null without one. */
export function numberAt(message: unknown, keys: Keys): number | null {
  let found: unknown = message;
  for (const key of keys) {
    if (typeof found !== "object" || found === null) return null;
    found = (found as Record<string | number, unknown>)[key];
  }
  if (typeof found === "boolean") return Number(found);
  return typeof found === "number" && Number.isFinite(found) ? found : null;
}

function collect(value: unknown, keys: Keys, path: string, depth: number, rows: Row[]): void {
  if (rows.length >= MAX_ROWS) return;
  const name = String(keys.at(-1) ?? "");
  const row = { path, keys, depth: depth - 1, name, isNumber: false };
  if (Array.isArray(value)) {
    const shown = value.slice(0, MAX_ITEMS);
    const more = value.length > shown.length ? `, the first ${shown.length} are` : "";
    rows.push({ ...row, text: `${value.length} item${value.length === 1 ? "" : "s"}${more}` });
    shown.forEach((item, index) => collect(item, [...keys, index], `${path}[${index}]`, depth + 1, rows));
  } else if (typeof value === "object" && value !== null) {
    if (depth > 0) rows.push({ ...row, text: "" });
    for (const [key, item] of Object.entries(value)) {
      collect(item, [...keys, key], path === "" ? key : `${path}.${key}`, depth + 1, rows);
    }
  } else {
    rows.push({ ...row, text: textOf(value), isNumber: typeof value === "number" || typeof value === "boolean" });
  }
}

/** A covariance of 1e-9 is not shown as zero. */
function numberText(value: number): string {
  if (Number.isInteger(value)) return digits(value, 0);
  const isUsual = Math.abs(value) >= 1e-3 && Math.abs(value) < 1e9;
  return isUsual ? digits(value, 4) : value.toExponential(3).replaceAll("-", "−");
}

function textOf(value: unknown): string {
  if (typeof value === "number") return numberText(value);
  const text = value === null ? "none" : String(value);
  return text.length > MAX_TEXT ? `${text.slice(0, MAX_TEXT)} … (${text.length} characters)` : text;
}
