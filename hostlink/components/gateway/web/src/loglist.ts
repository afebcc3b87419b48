/** A list of log lines, the newest last, filtered by level and words. It marks the line at the cursor's instant. */

import { make } from "./dom";
import type { PastLine } from "./past";
import { clock, type Timeline } from "./timeline";
import { dateText } from "./times";

const MAX_LINES = 500;
const LEVELS: Record<number, string> = { 1: "debug", 2: "info", 4: "warn", 8: "error", 16: "fatal" };
const NEAR_END_PX = 8;
const SAME_S = 1.5;

interface Item extends PastLine {
  element: HTMLLIElement;
}

export class LogList {
  readonly box: HTMLElement;

  private readonly list = make("ol", {});
  private items: Item[] = [];
  private level = 0;
  private words = "";
  private isFollowing = true; // the newest line stays in view until the user scrolls away from it

  constructor(
    private readonly timeline: Timeline,
    name: string,
    private readonly places = 0,
  ) {
    this.box = make("div", { role: "log", "aria-label": name, tabindex: "0" }, this.list);
    this.box.hidden = true;
    timeline.onChange(() => this.showInstant());
    const { box } = this;
    box.addEventListener("scroll", () => {
      if (timeline.cursor_s === null && box.clientHeight > 0) {
        this.isFollowing = box.scrollHeight - box.scrollTop - box.clientHeight < NEAR_END_PX;
      }
    });
    new ResizeObserver(() => this.follow()).observe(box);
    addEventListener("resize", () => this.follow()); // also after another layout: what is moved forgets where it was
  }

  get count(): number {
    return this.items.length;
  }

  add(line: PastLine): void {
    const item = this.make(line);
    this.items.push(item);
    this.list.append(item.element);
    while (this.items.length > MAX_LINES) this.items.shift()?.element.remove();
    this.box.hidden = false;
    this.follow();
  }

  private follow(): void {
    if (this.isFollowing && this.timeline.cursor_s === null && !this.timeline.isStored) this.toEnd();
  }

  private toEnd(): void {
    this.isFollowing = true;
    this.box.scrollTop = this.box.scrollHeight;
  }

  /** Add earlier lines, the oldest first. */
  prepend(lines: PastLine[]): void {
    const room = MAX_LINES - this.items.length;
    const unknown = lines.filter((line) => !this.items.some((item) => isSame(item, line)));
    const older = (room > 0 ? unknown.slice(-room) : []).map((line) => this.make(line));
    for (const { element } of older) element.classList.add("past");
    this.items = [...older, ...this.items].sort((one, other) => one.time_s - other.time_s).slice(-MAX_LINES);
    this.list.replaceChildren(...this.items.map(({ element }) => element));
    this.box.hidden = this.items.length === 0;
    this.toEnd();
  }

  /** `level`: lowest level; `words`: text in a line, ignoring case. */
  filter(level: number, words: string): void {
    this.level = level;
    this.words = words.toLowerCase();
    for (const item of this.items) item.element.hidden = !this.isWanted(item);
    this.toEnd();
  }

  private isWanted({ level, robot, text }: PastLine): boolean {
    return level >= this.level && `${robot} ${text}`.toLowerCase().includes(this.words);
  }

  /** Mark the newest line at the cursor's instant and dim later ones. */
  private showInstant(): void {
    const { cursor_s } = this.timeline;
    const shown = this.items.filter(({ element }) => !element.hidden);
    let marked: HTMLElement | null = null;
    for (const { time_s, element } of shown) {
      const isLater = cursor_s !== null && time_s > cursor_s;
      element.classList.toggle("later", isLater);
      element.removeAttribute("aria-current");
      if (cursor_s !== null && !isLater) marked = element;
    }
    marked?.setAttribute("aria-current", "true");
    if (marked) this.box.scrollTop = marked.offsetTop - this.box.clientHeight / 2;
    else this.follow();
  }

  private make(line: PastLine): Item {
    const { time_s, level, robot, text } = line;
    const name = LEVELS[level] ?? "info";
    const time = this.places > 0 ? this.timeline.label(time_s, this.places) : clock(time_s);
    const what = make("span", {}, ...(robot === "" ? [] : [make("i", {}, robot), " "]), text);
    const element = make(
      "li",
      { class: name },
      make("time", { title: dateText(new Date(1000 * time_s)) }, time),
      make("b", {}, name),
      what,
    );
    element.addEventListener("click", () => {
      this.timeline.pause();
      this.timeline.point(time_s);
    });
    element.hidden = !this.isWanted(line);
    return { ...line, element };
  }
}

/** Whether two lines are one event: a device's line is received live and is part of its history. */
function isSame(one: PastLine, other: PastLine): boolean {
  return one.robot === other.robot && one.text === other.text && Math.abs(one.time_s - other.time_s) < SAME_S;
}
