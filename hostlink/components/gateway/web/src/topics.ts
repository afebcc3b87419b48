/** Every topic with its type and rate; one of them can be opened. Requested once a second while visible. */

import "./style/topics.css";
import { arrange, digits, make, setText } from "./dom";
import type { Page } from "./page";
import { reasonOf, rest } from "./rest";
import { makeTimebar } from "./timebar";
import { OpenedTopic } from "./topic";
import { makeButton } from "./widgets";

const POLL_MS = 1000;
const MAX_SHOWN = 200;
const RATE_S = 4; // window of the rate

interface TopicView {
  name: string;
  type: string;
  publishers: number;
  subscribers: number;
  messages: number;
  is_derived: boolean; // hostlink publishes it, and mostly only while it has subscribers
}

interface Row {
  root: HTMLElement;
  type: HTMLElement;
  rate: HTMLElement;
}

interface Count {
  time_ms: number;
  messages: number;
}

export function startTopics(page: Page): HTMLElement {
  return new Topics(page).root;
}

class Topics {
  readonly root: HTMLElement;

  private readonly filter = make("input", {
    type: "search",
    placeholder: "name or type",
    "aria-label": "Filter topics",
    maxlength: "80",
  });
  private readonly list = make("ul", { class: "topics" });
  private readonly state = make("p", { class: "hint", role: "status" });
  private readonly rows = new Map<string, Row>();
  private readonly counts = new Map<string, Count[]>();
  private readonly timebar: HTMLElement;
  private topics: TopicView[] = [];
  private opened: OpenedTopic | null = null;

  constructor(private readonly page: Page) {
    this.root = make("section", {}, this.filter, this.state, this.list);
    this.filter.addEventListener("input", () => this.show());
    this.timebar = makeTimebar(page.timeline, "Topic");
    page.onRefusal((topic, reason) => topic === this.opened?.name && this.opened.refused(reason));
    setInterval(() => void this.poll(), POLL_MS);
  }

  private async poll(): Promise<void> {
    if (document.hidden || this.opened !== null || !this.list.checkVisibility()) return;
    try {
      this.topics = (await rest<{ topics: TopicView[] }>("GET", "api/topics")).topics;
      this.count();
      this.show();
    } catch (error) {
      this.counts.clear(); // the rate is unknown now
      this.show();
      setText(this.state, reasonOf(error));
    }
  }

  private count(): void {
    const time_ms = performance.now();
    const known = new Set(this.topics.map(({ name }) => name));
    for (const name of this.counts.keys()) if (!known.has(name)) this.counts.delete(name);
    for (const { name, messages } of this.topics) {
      const counts = (this.counts.get(name) ?? []).filter((each) => each.time_ms > time_ms - RATE_S * 1000);
      this.counts.set(name, [...counts, { time_ms, messages }]);
    }
  }

  private show(): void {
    const words = this.filter.value.toLowerCase();
    const found = this.topics.filter(({ name, type }) => `${name} ${type}`.toLowerCase().includes(words));
    const shown = found.slice(0, MAX_SHOWN);
    const names = new Set(shown.map(({ name }) => name));
    for (const name of this.rows.keys()) if (!names.has(name)) this.rows.delete(name);
    const rows = shown.map((topic) => {
      const row = this.rows.get(topic.name) ?? this.makeRow(topic.name);
      setText(row.type, topic.type || "unknown type");
      setText(row.rate, this.rate(topic));
      return row.root;
    });
    arrange(this.list, rows);
    const more = found.length > shown.length ? `, the first ${shown.length} are shown` : "";
    setText(this.state, `${found.length} topic${found.length === 1 ? "" : "s"}${more}`);
  }

  private rate({ name, publishers, subscribers, is_derived }: TopicView): string {
    const counts = this.counts.get(name) ?? [];
    const [first, last] = [counts[0], counts.at(-1)];
    if (!first || !last || last.time_ms === first.time_ms) return "";
    const rate = (1000 * (last.messages - first.messages)) / (last.time_ms - first.time_ms);
    if (rate > 0) return `${digits(rate, 1)} Hz`;
    if (publishers === 0) return "no publisher";
    return is_derived && subscribers === 0 ? "on demand" : "silent";
  }

  private makeRow(name: string): Row {
    const [type, rate] = [make("span", { class: "type" }), make("span", { class: "rate" })];
    const open = make("button", { type: "button" }, make("b", {}, name), type, rate);
    open.addEventListener("click", () => this.open(name));
    const row = { root: make("li", {}, open), type, rate };
    this.rows.set(name, row);
    return row;
  }

  private open(name: string): void {
    const topic = this.topics.find((each) => each.name === name);
    if (!topic) return;
    const opened = new OpenedTopic(this.page, name, topic.type, this.timebar);
    const close = makeButton("All topics", () => {
      opened.close();
      head.remove();
      this.opened = null;
      for (const element of [this.filter, this.list, this.state]) element.hidden = false;
      this.rows.get(name)?.root.querySelector("button")?.focus();
    });
    const head = make(
      "div",
      { class: "opening" },
      make("h3", {}, name),
      make("span", { class: "hint" }, topic.type),
      close,
    );
    for (const element of [this.filter, this.list, this.state]) element.hidden = true;
    this.list.after(head, opened.root);
    this.opened = opened;
    close.focus();
  }
}
