/** An opened topic: its values as a tree, a plot of chosen numbers, and a form that publishes. */

import { Chart } from "./chart";
import { ageText, make, setText } from "./dom";
import { saveCsv } from "./download";
import { MessageForm, type TypeDef } from "./form";
import type { Page } from "./page";
import { Series } from "./series";
import { now_s } from "./timeline";
import { timeText } from "./times";
import { type Keys, numberAt, ValueTree } from "./tree";
import { makeButton } from "./widgets";

const KEEP_S = 300;
const GAP_S = 5;
const MAX_LINES = 6;
const THROTTLE_MS = 20;
const DRAW_MS = 150;

interface PlottedField {
  path: string;
  keys: Keys;
}

export class OpenedTopic {
  readonly root: HTMLElement;

  private readonly tree = new ValueTree((path, keys, isOn) => this.choose(path, keys, isOn));
  private readonly state = make("p", { class: "hint", role: "status" }, "No message yet.");
  private readonly plot = make("div", { class: "charts" });
  private readonly plotTools: HTMLElement;
  private readonly unsubscribe: () => void;
  private readonly timer: number;
  private fields: PlottedField[] = [];
  private series = new Series(0, KEEP_S, GAP_S);
  private chart: Chart | null = null;
  private newest: unknown = null;
  private count = 0;
  private receivedAt = 0; // of the newest message, by the page's clock
  private form: MessageForm | null = null;
  private readonly publishButton = make("button", { type: "submit", class: "main" }, "Publish");
  private readonly publishState = make("p", { class: "hint", role: "status" });

  constructor(
    private readonly page: Page,
    readonly name: string,
    private readonly type: string,
    timebar: HTMLElement,
  ) {
    const save = makeButton("CSV", () => this.save(), { "aria-label": "Save the plotted values as CSV" });
    this.plotTools = make("div", { class: "plottools" }, timebar, save);
    this.plotTools.hidden = true;
    const hint = make("p", { class: "hint" }, "Select numbers to plot them in one chart.");
    const form = make("details", {}, make("summary", {}, "Publish"));
    form.addEventListener("toggle", () => form.open && this.form === null && void this.makeForm(form));
    const element = make(
      "div",
      { class: "opened" },
      this.state,
      this.plotTools,
      this.plot,
      make("div", { class: "values" }, hint, this.tree.element, form),
    );
    this.root = element;
    this.unsubscribe = page.connection.subscribe<unknown>(name, type, (msg) => this.receive(msg), THROTTLE_MS);
    this.timer = setInterval(() => this.draw(), DRAW_MS);
  }

  close(): void {
    this.unsubscribe();
    clearInterval(this.timer);
    this.chart?.destroy();
    this.root.remove();
  }

  /** Show that its message was refused. */
  refused(reason: string): void {
    setText(this.publishState, reason);
  }

  private receive(message: unknown): void {
    this.newest = message;
    this.receivedAt = performance.now();
    this.count += 1;
    if (this.fields.length > 0) this.series.add(now_s(), ...this.fields.map(({ keys }) => numberAt(message, keys)));
  }

  private draw(): void {
    this.publishButton.disabled = !this.page.canDrive;
    if (this.count === 0 || !this.root.checkVisibility()) return;
    const { timeline } = this.page;
    if (timeline.isLive) {
      this.tree.show(this.newest);
      this.chart?.redraw();
      const age_s = (performance.now() - this.receivedAt) / 1000;
      const isCut = this.page.connection.state !== "open";
      this.tree.element.classList.toggle("stale", isCut);
      const old = isCut ? `; no connection, the newest is ${ageText(age_s)} old` : "";
      setText(this.state, `${this.count.toLocaleString("en")} messages since opening${old}`);
    }
  }

  /** Return false if there is no room for another line. */
  private choose(path: string, keys: Keys, isOn: boolean): boolean {
    if (isOn && this.fields.length >= MAX_LINES) {
      setText(this.state, `At most ${MAX_LINES} fields are plotted.`);
      return false;
    }
    const before = this.fields;
    this.fields = isOn ? [...before, { path, keys }] : before.filter((field) => field.path !== path);
    const from = this.fields.map((field) => before.indexOf(field));
    const rows = this.series.rows();
    this.series = new Series(this.fields.length, KEEP_S, GAP_S);
    if (isOn ? before.length > 0 : this.fields.length > 0) {
      for (const [time, ...values] of rows) this.series.add(time, ...from.map((index) => values[index] ?? null));
    }
    this.chart?.destroy();
    this.chart = null;
    this.plotTools.hidden = this.fields.length === 0;
    if (this.fields.length === 0) return true;
    const lines = this.fields.map((field, index) => ({ label: field.path, colour: `line-${index + 1}` }));
    const options = { name: this.name, places: 3, least: 0.01, isFromZero: false };
    this.chart = new Chart(this.page.timeline, lines, options, this.series);
    this.plot.append(this.chart.figure);
    return true;
  }

  private save(): void {
    const names = ["time_s", ...this.fields.map(({ path }) => path)];
    saveCsv(`${this.name.replaceAll("/", "_").replace(/^_/, "")}.csv`, names, this.series.rows());
  }

  private async makeForm(details: HTMLElement): Promise<void> {
    const state = this.publishState;
    try {
      const { typedefs } = await this.page.connection.call<{ typedefs: TypeDef[] }>("/rosapi/message_details", {
        type: this.type,
      });
      this.form = new MessageForm(typedefs);
    } catch (error) {
      setText(state, `The fields of ${this.type} are unknown: ${error instanceof Error ? error.message : ""}`);
      details.append(state);
      return;
    }
    const actions = make("div", { class: "actions" }, state, this.publishButton);
    const form = make("form", { novalidate: "", "aria-label": `Publish on ${this.name}` }, this.form.element, actions);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.publish();
    });
    details.append(form);
  }

  private publish(): void {
    const state = this.publishState;
    try {
      const isSent = this.form !== null && this.page.connection.publish(this.name, this.form.read());
      const time = timeText(new Date());
      setText(state, isSent ? `Sent at ${time}.` : "Not sent: no connection.");
    } catch (error) {
      setText(state, error instanceof Error ? error.message : String(error));
    }
  }
}
