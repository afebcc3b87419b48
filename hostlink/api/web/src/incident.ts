/** One incident, opened over the page: path, plots and log around it, on one timeline. The stop stays visible. */

import "./style/incident.css";
import { make } from "./dom";
import { makeDownload } from "./download";
import { LogList } from "./loglist";
import { notice } from "./notice";
import { makeButton } from "./widgets";
import { type HistoryView, linesOf } from "./past";
import { PathView } from "./pathview";
import { RobotCharts } from "./robotcharts";
import { reasonOf, rest } from "./rest";
import { makeTimebar } from "./timebar";
import { Timeline } from "./timeline";
import type { IncidentView } from "./views";

const TIMEOUT_MS = 15_000; // a whole file is read
const LEAST_S = 5; // shortest time shown

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

export class IncidentWindow {
  private root: HTMLElement | null = null;

  /** `opener` gets the focus back. */
  async open(incident: IncidentView, opener: HTMLElement): Promise<void> {
    try {
      const path = `api/incidents/${encodeURIComponent(incident.file)}`;
      const opened = await rest<OpenedIncident>("GET", `${path}/history`, undefined, TIMEOUT_MS);
      this.close();
      this.show(opened, makeDownload(path, incident.file), opener);
    } catch (error) {
      notice("refused", `Incident: ${reasonOf(error)}`, 5000);
    }
  }

  private close(): void {
    this.root?.remove();
    this.root = null;
  }

  private show(incident: OpenedIncident, download: HTMLElement, opener: HTMLElement): void {
    const { history, robot, cause } = incident;
    const zero_s = Date.parse(incident.at) / 1000;
    const [begin, end] = extent(history);
    const timeline = new Timeline(end - begin, [zero_s + begin, zero_s + end], zero_s);
    const poses = history.poses.map(({ pose, age_s }) => ({ pose, time_s: zero_s - age_s }));
    const path = new PathView(timeline, poses);
    const charts = new RobotCharts(timeline, Number.POSITIVE_INFINITY, "incident-");
    charts.prepend(history, zero_s);
    for (const figure of charts.wheelFigures) figure.hidden = history.plot_data.length === 0;
    const log = new LogList(timeline, "Log of the incident", 1);
    log.prepend(linesOf(history, "", zero_s));

    const title = make("h2", { id: "incident-title", tabindex: "-1" }, `${causeInWords(cause)}: ${robot}`);
    const close = makeButton("Close", () => {
      this.close();
      opener.focus();
    });
    const head = make("div", { class: "head" }, title, make("div", { class: "tools" }, download, close));
    const zooms = make(
      "div",
      { class: "zooms" },
      makeButton("+", () => path.zoom(1.5), { "aria-label": "Path: zoom in" }),
      makeButton("−", () => path.zoom(1 / 1.5), { "aria-label": "Path: zoom out" }),
      makeButton("Fit", () => path.fit(), { "aria-label": "Path: fit" }),
    );
    const left = make("div", { class: "side" }, make("div", { class: "where" }, path.canvas, zooms), log.box);
    const right = make(
      "div",
      { class: "charts", role: "group", "aria-label": "Plots", tabindex: "0" },
      ...charts.speedFigures,
      ...charts.wheelFigures,
    );
    const body = make("div", { class: "sides" }, left, right);
    const facts = make("p", { class: "facts" }, factsOf(incident));
    const command = make(
      "p",
      { class: "hint" },
      "In a terminal:",
      make("code", {}, `hostlink plot ${incident.file} --map`),
    );
    this.root = make(
      "section",
      { id: "incident", class: "window", "aria-labelledby": "incident-title" },
      ...[head, facts, makeTimebar(timeline, "Incident"), body, command],
    );
    document.body.append(this.root);
    title.focus();
  }
}

export function causeInWords(cause: string): string {
  return CAUSES[cause] ?? cause;
}

function factsOf({ at, detail, damage }: OpenedIncident): string {
  const when = new Date(at).toLocaleString([], { hour12: false });
  return [when, detail, ...damage.map((each) => `The file is damaged: ${each}`)].filter(Boolean).join(" · ");
}

/** Range of the data, in seconds from the incident. */
function extent({ poses, commands = [], plot_data, events }: HistoryView): [begin_s: number, end_s: number] {
  const ages = [...poses, ...commands, ...plot_data, ...events].map(({ age_s }) => -age_s);
  const [begin, end] = [Math.min(0, ...ages), Math.max(0, ...ages)];
  return end - begin < LEAST_S ? [begin - LEAST_S / 2, end + LEAST_S / 2] : [begin, end];
}
