/**
 * The frame: tabs of the layouts, and columns with panels. Each panel has a bar to fold, maximise and move it, and an edge
 * that gives it another height; columns have edges for their widths.
 */

import { ageText, find, make, remember, remembered, setText } from "./dom";
import { COLUMNS, LAYOUTS, type LayoutName, Layouts } from "./layouts";
import type { Page } from "./page";
import { type Feed, PANELS, type Panel } from "./panels";
import { Sizes } from "./sizes";
import { addCloser } from "./open";
import { makeSplitter } from "./splitter";

const SHORT = "(max-height: 640px)";
const PHONE =
  "(max-width: 479px), (max-width: 599px) and (min-height: 421px), (max-width: 719px) and (min-height: 521px), " +
  "(max-width: 899px) and (min-height: 521px) and (max-height: 640px)";
const TABLET = "(max-width: 899px) and (min-height: 641px)"; // in portrait, where it is not a phone
const NARROW = "(max-width: 767px)"; // too narrow for three columns, and not a phone in portrait
const WIDE = "(min-width: 1700px)";
const LEAST_PX = { height: 80, width: 200 };
const MOST_SHARE = { height: 1, width: 0.4 }; // of the column's height, of the width of all columns

interface Framed {
  panel: Panel;
  element: HTMLElement;
  fold: HTMLButtonElement;
  full: HTMLButtonElement;
  age: HTMLElement;
  body: HTMLElement;
}

export class Frame {
  layout: LayoutName;

  private readonly isWide = matchMedia(WIDE);
  private readonly layouts = new Layouts(
    PANELS,
    () => this.isWide.matches,
    remembered("panels", ""),
    (kept) => remember("panels", kept),
  );
  private readonly sizes = new Sizes(remembered("sizes", ""), (kept) => remember("sizes", kept));
  private readonly main = find("main");
  private readonly folded = new Set(remembered("folded", "").split(" ").filter(Boolean));
  private readonly framed = new Map<string, Framed>();
  private readonly tabs = new Map<LayoutName, HTMLButtonElement>();
  private readonly isPhone = matchMedia(PHONE);
  private readonly isShort = matchMedia(SHORT);
  private readonly isTablet = matchMedia(TABLET);
  private readonly isNarrow = matchMedia(NARROW);
  private maximised: string | null = null; // name of the panel that covers the others
  private readonly menu = new PanelMenu(this);

  /** `onLayout` is called when another layout is shown, or other panels of it. */
  constructor(
    page: Page,
    private readonly onLayout: (layout: LayoutName) => void,
  ) {
    this.layout = LAYOUTS.find((each) => each === remembered("layout", "Drive")) ?? "Drive";
    for (const panel of PANELS) this.add(panel, page);
    for (const name of LAYOUTS) {
      const tab = make("button", { type: "button" }, name);
      tab.addEventListener("click", () => this.choose(name));
      this.tabs.set(name, tab);
      find("#layouts").append(tab);
    }
    for (const query of [this.isPhone, this.isTablet, this.isShort, this.isNarrow, this.isWide])
      query.addEventListener("change", () => this.arrange());
    this.main.append(this.makeEdge("left"), this.makeEdge("right"));
    addCloser(() => {
      if (this.maximised === null) return false;
      this.maximise(null);
      return true;
    });
    addCloser(() => this.menu.close());
    this.arrange();
  }

  choose(layout: LayoutName): void {
    this.layout = layout;
    this.maximised = null;
    remember("layout", layout);
    this.arrange();
  }

  /** Let a panel cover the others; null: show all of them again. */
  maximise(name: string | null): void {
    this.maximised = name;
    this.showMaximised();
    this.changed();
  }

  /** Put every panel in its place. A panel that stays is not touched: a finger may be on it. */
  arrange(): void {
    const arrangement = this.layouts.arrangement(this.layout);
    const { matches: isPhone } = this.isPhone;
    const columns = { left: [...arrangement.left], middle: [...arrangement.middle], right: [...arrangement.right] };
    if (isPhone) {
      const all = PANELS.filter(({ name }) => !arrangement.away.includes(name));
      columns.left = all.map(({ name }) => name).filter(isFirst);
      columns.middle = [];
      columns.right = all.map(({ name }) => name).filter((name) => !isFirst(name));
    }
    const isTablet = !isPhone && this.isTablet.matches;
    const isPair = !isPhone && !isTablet && this.isNarrow.matches;
    if ((isTablet || isPair) && columns.left.length > 0) {
      columns.middle.splice(1, 0, ...columns.right.filter(isFirst)); // after the map
      columns.middle.push(...columns.right.filter((name) => !isFirst(name)));
      columns.right = [];
    }
    for (const column of COLUMNS) this.fill(find(`main > .${column}`), columns[column]);
    this.fill(find("#shelf"), arrangement.away);
    document.body.dataset.layout = this.layout;
    document.body.dataset.shape = isPhone ? "phone" : "columns";
    document.body.dataset.columns = isTablet ? "tablet" : isPair ? "two" : "three";
    const isStrip = this.layout !== "Fleet" && (isPhone || this.isShort.matches);
    document.body.dataset.robots = isStrip ? "strip" : "list";
    for (const [name, tab] of this.tabs) tab.setAttribute("aria-pressed", String(name === this.layout));
    if (this.maximised !== null && arrangement.away.includes(this.maximised)) this.maximised = null;
    this.showMaximised();
    this.showSizes();
    this.changed();
  }

  /** What is held may have moved: the joystick measures its position again. */
  private changed(): void {
    dispatchEvent(new Event("resize"));
    this.onLayout(this.layout);
  }

  /** Show how old the values of each feed are; null: they are up to date. */
  showAges(ages_s: Record<Feed, number | null>): void {
    for (const { panel, element, age } of this.framed.values()) {
      const age_s = panel.feed ? ages_s[panel.feed] : null;
      element.classList.toggle("aged", age_s !== null);
      setText(age, age_s === null ? "" : `${ageText(age_s)} old`);
    }
  }

  isFolded(name: string): boolean {
    return this.folded.has(name);
  }

  fold(name: string): void {
    if (!this.folded.delete(name)) this.folded.add(name);
    remember("folded", [...this.folded].join(" "));
    const framed = this.framed.get(name);
    if (framed) this.showFold(framed);
  }

  /** An action of the panel menu: label and function; `isOn` for the chosen one of several. */
  choices(name: string): { label: string; isOn?: boolean; act: () => void }[] {
    const { layout, layouts } = this;
    const done = (act: () => void) => () => {
      act();
      this.arrange();
    };
    const isHere = layouts.columnOf(layout, name);
    return [
      { label: this.isFolded(name) ? "Unfold" : "Fold", act: () => this.fold(name) },
      { label: "Up", act: done(() => layouts.shift(layout, name, -1)) },
      { label: "Down", act: done(() => layouts.shift(layout, name, 1)) },
      ...COLUMNS.map((column) => ({
        label: `To the ${column}`,
        isOn: isHere === column,
        act: done(() => layouts.put(layout, name, column)),
      })),
      ...LAYOUTS.map((each) => ({
        label: `In ${each}`,
        isOn: layouts.columnOf(each, name) !== "away",
        act: done(() => {
          const isIn = layouts.columnOf(each, name) !== "away";
          layouts.put(each, name, isIn ? "away" : (PANELS.find((one) => one.name === name)?.places[each] ?? "right"));
        }),
      })),
      {
        label: `Reset ${layout}`,
        act: done(() => {
          layouts.reset(layout);
          this.sizes.reset(layout);
        }),
      },
    ];
  }

  /** A bar with title, the panel's own controls (`data-bar`) and its menu; the body is below. */
  private add(panel: Panel, page: Page): void {
    const { name, title } = panel;
    const element = panel.start?.(page) ?? find(`#${name}`);
    element.id = name;
    element.classList.add("panel");
    element.setAttribute("aria-labelledby", `${name}-title`);
    const fold = make("button", { type: "button", class: "fold", "aria-expanded": "true" }, title);
    const full = make("button", { type: "button", class: "full", "aria-label": `${title}: maximise` });
    const more = make("button", { type: "button", class: "more", "aria-label": `${title}: move, fold` }, "⋯");
    const extras = element.querySelectorAll(":scope > [data-bar]");
    const body = make("div", { class: "body", id: `${name}-body` });
    const age = make("span", { class: "age" });
    const ends = make("span", { class: "ends" }, full, more);
    const bar = make("div", { class: "bar" }, make("h2", { id: `${name}-title` }, fold), age, ...extras, ends);
    body.append(...element.childNodes);
    const edge = makeSplitter({
      label: `Height of ${title}`,
      axis: "y",
      size: () => element.offsetHeight,
      bounds: () => [LEAST_PX.height, MOST_SHARE.height * (element.parentElement?.clientHeight ?? innerHeight)],
      resize: (size) => this.resize(name, size),
    });
    element.append(bar, body, edge);
    fold.setAttribute("aria-controls", body.id);
    fold.addEventListener("click", () => this.fold(name));
    full.addEventListener("mousedown", (event) => event.preventDefault()); // no focus: keys go on driving
    full.addEventListener("click", () => this.maximise(this.maximised === name ? null : name));
    more.addEventListener("click", () => this.menu.open(name, title, more));
    const framed = { panel, element, fold, full, age, body };
    this.framed.set(name, framed);
    this.showFold(framed);
  }

  /** The edge between a column and its neighbour. */
  private makeEdge(column: "left" | "right"): HTMLElement {
    const edge = makeSplitter({
      label: `Width of the ${column} column`,
      axis: "x",
      isBefore: column === "right",
      size: () => find(`main > .${column}`).offsetWidth,
      bounds: () => [LEAST_PX.width, MOST_SHARE.width * this.main.clientWidth],
      resize: (size) => this.resize(column, size),
    });
    edge.classList.add(`of-${column}`);
    return edge;
  }

  private resize(name: string, size: number | null): void {
    this.sizes.set(this.layout, name, size);
    this.showSizes();
  }

  private showSizes(): void {
    const isPhone = document.body.dataset.shape === "phone"; // it has one column, which scrolls
    const give = (element: HTMLElement, property: string, name: string) => {
      const size = isPhone ? null : this.sizes.of(this.layout, name);
      element.style.setProperty(property, size === null ? null : `${size}px`);
      return size !== null;
    };
    for (const [name, { element }] of this.framed) element.classList.toggle("sized", give(element, "--height", name));
    for (const column of ["left", "right"]) give(this.main, `--${column}`, column);
  }

  private showMaximised(): void {
    for (const [name, framed] of this.framed) {
      const isIt = name === this.maximised;
      framed.element.classList.toggle("maximised", isIt);
      framed.full.setAttribute("aria-pressed", String(isIt));
      framed.full.title = isIt ? "Show all panels again (Escape)" : "Show this panel alone";
      this.showFold(framed);
    }
  }

  private showFold({ panel, element, fold, body }: Framed): void {
    const isFolded = this.isFolded(panel.name) && this.maximised !== panel.name;
    body.hidden = isFolded;
    element.classList.toggle("folded", isFolded);
    fold.setAttribute("aria-expanded", String(!isFolded));
  }

  private fill(place: HTMLElement, names: string[]): void {
    names.forEach((name, index) => {
      const element = this.framed.get(name)?.element;
      if (element && place.children[index] !== element) place.insertBefore(element, place.children[index] ?? null);
    });
  }
}

function isFirst(name: string): boolean {
  return PANELS.find((panel) => panel.name === name)?.isFirst === true;
}

/** One menu for all panels, next to the button that opened it. */
class PanelMenu {
  private readonly box = make("div", { id: "panel-menu", popover: "", role: "menu" });

  constructor(private readonly frame: Frame) {
    const { box } = this;
    document.body.append(box);
    box.addEventListener("keydown", (event) => this.move(event));
  }

  /** Return whether it was open. */
  close(): boolean {
    const isOpen = this.box.matches(":popover-open");
    this.box.hidePopover();
    return isOpen;
  }

  /** Arrow keys wrap around; Home and End go to the ends. */
  private move(event: KeyboardEvent): void {
    const items = [...this.box.querySelectorAll("button")];
    const at = items.findIndex((item) => item === document.activeElement);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: -1 }[event.code];
    if (to === undefined) return;
    event.preventDefault();
    items.at(to % items.length)?.focus();
  }

  open(name: string, title: string, button: HTMLElement): void {
    const { box } = this;
    const heading = make("p", { role: "presentation" });
    setText(heading, title);
    const items = this.frame.choices(name).map(({ label, isOn, act }) => {
      const role = isOn === undefined ? "menuitem" : "menuitemcheckbox";
      const item = make("button", { type: "button", role }, label);
      if (isOn !== undefined) item.setAttribute("aria-checked", String(isOn));
      item.addEventListener("click", () => {
        box.hidePopover();
        act();
      });
      return item;
    });
    box.replaceChildren(heading, ...items);
    box.showPopover();
    const at = button.getBoundingClientRect();
    box.style.left = `${Math.max(4, Math.min(at.right - box.offsetWidth, innerWidth - box.offsetWidth - 4))}px`;
    box.style.top = `${Math.max(4, Math.min(at.bottom + 4, innerHeight - box.offsetHeight - 4))}px`;
    items[0]?.focus();
  }
}
