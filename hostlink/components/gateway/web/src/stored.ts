/**
 * An incident or a recording, opened over the page: path, plots and log on one timeline. The stop stays visible.
 *
 * An incident is shown from some seconds before it to some after it, with the cursor at its time.
 */

import "./style/incident.css";
import { make } from "./dom";
import { makeDownload } from "./download";
import { LogList } from "./loglist";
import { notice } from "./notice";
import { addCloser } from "./open";
import { bytes, duration, makeButton } from "./widgets";
import { type HistoryView, linesOf } from "./past";
import { PathView } from "./pathview";
import { RobotCharts } from "./robotcharts";
import { reasonOf, rest } from "./rest";
import { makeTimebar } from "./timebar";
import { Timeline } from "./timeline";
import { dateText } from "./times";
import type { IncidentView } from "./views";

const TIMEOUT_MS = 15_000; // a whole file is read
const LEAST_S = 5; // shortest time shown
const AROUND_S = { before: 15, after: 10 }; // shown of an incident at first

/** In the words of `hostlink incidents`: docs/recording.md#the-black-box */
const CAUSES: Record<string, string> = {
  locked: "Emergency stop",
  lease: "Driver fell silent",
  gone: "Link lost while driven",
  diagnosed: "Found by doctor",
  device_error: "Error of the device",
  watchdog: "Stopped by its watchdog",
  daemon_died: "hostlink ended while the robot was driven",
  requested: "Saved on request",
};

interface OpenedIncident extends IncidentView {
  history: HistoryView;
  damage: string[];
}

/** GET api/recordings/NAME/history */
interface OpenedRecording {
  file: string;
  bytes: number;
  robot: string;
  robots: string[];
  begin: string;
  seconds: number;
  history: HistoryView;
  damage: string[];
}

interface Shown {
  title: string;
  facts: string[];
  file: string;
  path: string; // of the file, for its download
  history: HistoryView;
  zero_s: number; // of the incident, or of the beginning of the recording
  isIncident: boolean;
  tools?: HTMLElement[];
}

export class StoredWindow {
  private root: HTMLElement | null = null;
  private opener: HTMLElement | null = null; // gets the focus back

  constructor() {
    addCloser(() => this.leave());
  }

  /** `opener` gets the focus back. */
  async openIncident(incident: IncidentView, opener: HTMLElement): Promise<void> {
    const path = `api/incidents/${encodeURIComponent(incident.file)}`;
    try {
      const opened = await rest<OpenedIncident>("GET", `${path}/history`, undefined, TIMEOUT_MS);
      const { robot, cause, detail, at, history, damage, file } = opened;
      const title = `${causeInWords(cause)}: ${robot}`;
      const facts = [dateText(new Date(at)), detail, ...damage.map(damageText)];
      this.show({ title, facts, file, path, history, zero_s: Date.parse(at) / 1000, isIncident: true }, opener);
    } catch (error) {
      notice("refused", `Incident: ${reasonOf(error)}`, 5000);
    }
  }

  /** `robot`: of several in the recording; empty: the first one. Throws the reason of a failure. */
  async openRecording(file: string, opener: HTMLElement, robot = ""): Promise<void> {
    const path = `api/recordings/${encodeURIComponent(file)}`;
    const query = robot === "" ? "" : `?robot=${encodeURIComponent(robot)}`;
    const opened = await rest<OpenedRecording>("GET", `${path}/history${query}`, undefined, TIMEOUT_MS);
    const { begin, seconds, robots, history, damage } = opened;
    const select = make("select", { "aria-label": "Robot of the recording" });
    select.append(...robots.map((each) => make("option", { value: each }, each)));
    select.value = opened.robot;
    select.addEventListener("change", () => {
      this.openRecording(file, opener, select.value).catch((error: unknown) =>
        notice("refused", `Recording: ${reasonOf(error)}`, 5000),
      );
    });
    const title = opened.robot === "" ? file : `${file}: ${opened.robot}`;
    const facts = [
      `${dateText(new Date(begin))}, ${duration(seconds)} long`,
      bytes(opened.bytes),
      ...damage.map(damageText),
    ];
    const tools = robots.length > 1 ? [select] : [];
    this.show(
      { title, facts, file, path, history, zero_s: Date.parse(begin) / 1000, isIncident: false, tools },
      opener,
    );
  }

  /** Return false if it is not open. */
  private close(): boolean {
    if (this.root === null) return false;
    this.root.remove();
    this.root = null;
    return true;
  }

  private leave(): boolean {
    const isOpen = this.close();
    if (isOpen) this.opener?.focus();
    return isOpen;
  }

  private show(
    { title, facts, file, path, history, zero_s, isIncident, tools = [] }: Shown,
    opener: HTMLElement,
  ): void {
    this.close();
    const name = isIncident ? "Incident" : "Recording";
    const [begin, end] = isIncident ? extent(history) : [0, Math.max(LEAST_S, extent(history)[1])];
    const timeline = new Timeline(end - begin, [zero_s + begin, zero_s + end], zero_s);
    const poses = history.poses.map(({ pose, age_s }) => ({ pose, time_s: zero_s - age_s }));
    const view = new PathView(timeline, poses, isIncident);
    const charts = new RobotCharts(timeline, Number.POSITIVE_INFINITY, "incident-");
    charts.prepend(history, zero_s);
    for (const figure of charts.wheelFigures) figure.hidden = history.plot_data.length === 0;
    const log = new LogList(timeline, `Log of the ${name.toLowerCase()}`, 1);
    log.prepend(linesOf(history, "", zero_s));

    const heading = make("h2", { id: "incident-title", tabindex: "-1" }, title);
    this.opener = opener;
    const close = makeButton("Close", () => this.leave(), { title: "Escape closes it, too" });
    const download = makeDownload(path, file);
    const head = make("div", { class: "head" }, heading, make("div", { class: "tools" }, ...tools, download, close));
    const zooms = make(
      "div",
      { class: "zooms" },
      makeButton("+", () => view.zoom(1.5), { "aria-label": "Path: zoom in" }),
      makeButton("−", () => view.zoom(1 / 1.5), { "aria-label": "Path: zoom out" }),
      makeButton("Fit", () => view.fit(), { "aria-label": "Path: fit" }),
    );
    const left = make("div", { class: "side" }, make("div", { class: "where" }, view.canvas, zooms), log.box);
    const right = make(
      "div",
      { class: "charts", role: "group", "aria-label": "Plots", tabindex: "0" },
      ...charts.speedFigures,
      ...charts.wheelFigures,
    );
    const body = make("div", { class: "sides" }, left, right);
    const told = make("p", { class: "facts" }, facts.filter(Boolean).join(" · "));
    const command = make("p", { class: "hint" }, "In a terminal: ", make("code", {}, `hostlink plot ${file} --map`));
    this.root = make(
      "section",
      { id: "incident", class: "window", "aria-labelledby": "incident-title" },
      ...[head, told, makeTimebar(timeline, name), body, command],
    );
    document.body.append(this.root);
    if (isIncident)
      timeline.show(
        Math.max(zero_s + begin, zero_s - AROUND_S.before),
        Math.min(zero_s + end, zero_s + AROUND_S.after),
      );
    timeline.point(isIncident ? zero_s : zero_s + begin);
    heading.focus();
  }
}

export function causeInWords(cause: string): string {
  return CAUSES[cause] ?? cause;
}

function damageText(damage: string): string {
  return damage.startsWith("only") ? damage : `The file is damaged: ${damage}`;
}

/** Range of the data, in seconds from the incident. */
function extent({ poses, commands = [], plot_data, events }: HistoryView): [begin_s: number, end_s: number] {
  let [begin, end] = [0, 0];
  for (const { age_s } of [...poses, ...commands, ...plot_data, ...events]) {
    begin = Math.min(begin, -age_s);
    end = Math.max(end, -age_s);
  }
  return end - begin < LEAST_S ? [begin - LEAST_S / 2, end + LEAST_S / 2] : [begin, end];
}
