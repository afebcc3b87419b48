/** The incidents panel: incidents of robots, the newest first. Each opens with its path, plots and log. */

import "./style/recordings.css";
import { arrange, make, setText } from "./dom";
import { makeDownload } from "./download";
import type { Page } from "./page";
import { reasonOf, rest } from "./rest";
import { causeInWords, StoredWindow } from "./stored";
import { dateText, timeText } from "./times";
import type { IncidentCounts, IncidentView } from "./views";
import { bytes, makeButton } from "./widgets";

const MAX_SHOWN = 100;
const PATH = "api/incidents";

export function startIncidents(page: Page): HTMLElement {
  const panel = new Incidents(page);
  page.onRecordings(({ incidents }) => panel.show(incidents));
  return panel.root;
}

class Incidents {
  readonly root: HTMLElement;

  private readonly list = make("ul", { class: "incidents" });
  private readonly state = make("p", { class: "hint", role: "status" });
  private readonly window = new StoredWindow();
  private known = "";
  private items = new Map<string, HTMLElement>(); // what the list shows, by the whole content of each

  constructor(private readonly page: Page) {
    const hint = make(
      "p",
      { class: "hint none" },
      "No incidents. Emergency stops, lost links and errors are saved here.",
    );
    const save = makeButton("Save now", () => void this.save(), {
      "data-bar": "",
      title: "Save the last minutes of the chosen robot, and the next half minute",
    });
    page.onShow(() => {
      save.disabled = !page.canDrive || page.fleet.robot === undefined;
    });
    this.root = make("section", {}, save, this.state, this.list, hint);
  }

  /** Numbers of incidents: when they change, the list is loaded again. */
  show(counts: IncidentCounts): void {
    const key = JSON.stringify(counts);
    if (key === this.known) return;
    this.known = key;
    void this.load();
  }

  private async load(): Promise<void> {
    try {
      const { incidents, missed } = await rest<{ incidents: IncidentView[]; missed: number }>("GET", PATH);
      const before = this.items;
      this.items = new Map();
      for (const each of incidents.slice(0, MAX_SHOWN)) {
        const key = JSON.stringify(each);
        this.items.set(key, before.get(key) ?? this.makeItem(each));
      }
      arrange(this.list, this.items.values());
      setText(
        this.state,
        missed > 0 ? `${missed} incidents could not be saved; see the log of hostlink for the reason.` : "",
      );
    } catch (error) {
      this.known = "";
      setText(this.state, reasonOf(error));
    }
  }

  private makeItem(incident: IncidentView): HTMLElement {
    const { robot, cause, detail, at, file } = incident;
    const words = causeInWords(cause);
    const when = new Date(at);
    const time = make("time", { datetime: at }, dateText(when));
    const title = make("span", { class: "what" }, make("b", {}, words), " ", make("i", {}, robot), " ", time);
    const item = make("li", { "data-cause": cause }, title, " ", make("span", { class: "detail" }, detail), " ");
    if (file === "") item.append(make("em", {}, "being saved, with the half minute after the incident"));
    else {
      const open = makeButton("Open", () => void this.window.openIncident(incident, open), {
        "aria-label": `Open ${words} of ${robot} at ${timeText(when)}`,
        title: bytes(incident.bytes),
      });
      item.append(make("span", { class: "actions" }, open, makeDownload(`${PATH}/${encodeURIComponent(file)}`, file)));
    }
    return item;
  }

  private async save(): Promise<void> {
    const robot = this.page.fleet.robot?.name;
    if (robot === undefined) {
      setText(this.state, "No robot is connected.");
      return;
    }
    try {
      await rest("POST", PATH, { robot, reason: "saved on the page" });
      await this.load();
    } catch (error) {
      setText(this.state, reasonOf(error));
    }
  }
}
