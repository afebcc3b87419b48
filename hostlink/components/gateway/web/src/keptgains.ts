/** Gains that this browser keeps under names. */

import { make, remember, remembered } from "./dom";
import { makeButton, makeField } from "./widgets";

const KEY = "gains.kept";
const MAX_KEPT = 50; // above it the oldest is removed

/** By input name: side and gain. */
export type Gains = Record<string, string>;

export class KeptGains {
  private readonly choice = make("select", {});
  private readonly name = make("input", { type: "text", maxlength: "40", placeholder: "a name" });
  private kept: [name: string, gains: Gains][] = load();

  /** `present` reads the form; `apply` writes to it. */
  constructor(
    place: HTMLElement,
    private readonly present: () => Gains,
    private readonly apply: (gains: Gains) => void,
  ) {
    this.choice.addEventListener("change", () => {
      const found = this.kept.find(([name]) => name === this.choice.value);
      if (found) this.apply(found[1]);
    });
    const save = makeButton("Save", () => this.save());
    const remove = makeButton("Remove", () => this.remove(), { "aria-label": "Remove the chosen gains" });
    place.append(
      make(
        "div",
        { class: "kept" },
        make("div", { class: "row" }, makeField("Saved gains", this.choice), remove),
        make("div", { class: "row" }, makeField("Save these as", this.name), save),
      ),
    );
    this.show("");
  }

  private save(): void {
    const name = this.name.value.trim();
    if (name === "") {
      this.name.focus();
      return;
    }
    this.kept = [...this.kept.filter(([each]) => each !== name), [name, this.present()] as [string, Gains]].slice(
      -MAX_KEPT,
    );
    this.name.value = "";
    this.store(name);
  }

  private remove(): void {
    this.kept = this.kept.filter(([name]) => name !== this.choice.value);
    this.store("");
  }

  private store(chosen: string): void {
    remember(KEY, JSON.stringify(this.kept));
    this.show(chosen);
  }

  private show(chosen: string): void {
    const first = make("option", { value: "" }, this.kept.length === 0 ? "none yet" : "choose …");
    this.choice.replaceChildren(first, ...this.kept.map(([name]) => make("option", { value: name }, name)));
    this.choice.value = chosen;
  }
}

/** Gains of another version, and damaged ones, are ignored. */
function load(): [string, Gains][] {
  try {
    const found: unknown = JSON.parse(remembered(KEY, "[]"));
    return Array.isArray(found) ? found.filter(isKept).slice(-MAX_KEPT) : [];
  } catch {
    return [];
  }
}

function isKept(entry: unknown): entry is [string, Gains] {
  if (!Array.isArray(entry) || typeof entry[0] !== "string") return false;
  const gains: unknown = entry[1];
  return typeof gains === "object" && gains !== null && Object.values(gains).every((each) => typeof each === "string");
}
