/** The panel of the drive history: driver, times and reason of the end, the newest first. */

import "./style/recordings.css";
import { driverText } from "./clients";
import { ageText, digits, make, setText } from "./dom";
import type { Page } from "./page";
import { reasonOf, rest } from "./rest";
import { dateText } from "./times";
import { type DriveView, reasonText } from "./views";

const MAX_SHOWN = 50;
const PATH = `api/drives?limit=${MAX_SHOWN}`;
const [DRIVES, DROVE] = ["drives now", "was driving at the last contact with hostlink"];
const INTERVAL_MS = 1000; // shortest time between two requests

export function startDrives(page: Page): HTMLElement {
  const panel = new Drives(page);
  page.onShow(() => panel.show());
  return panel.root;
}

class Drives {
  readonly root: HTMLElement;

  private readonly list = make("ul", { class: "drives", tabindex: "0", "aria-labelledby": "drives-title" });
  private readonly state = make("p", { class: "hint", role: "status" });
  private known: string | null = null; // drivers when the list was loaded
  private loadedAt = Number.NEGATIVE_INFINITY;

  constructor(private readonly page: Page) {
    this.root = make("section", {}, this.state, this.list, make("p", { class: "hint none" }, "No drives yet."));
  }

  /** Load the list when a drive began or ended, if the panel is visible. */
  show(): void {
    const { isHeard } = this.page.fleet;
    for (const still of this.list.querySelectorAll(".still")) setText(still as HTMLElement, isHeard ? DRIVES : DROVE);
    if (!isHeard) this.known = null; // reload after the next contact
    if (!isHeard) return;
    const now = performance.now();
    const key = JSON.stringify(this.page.fleet.robots.map(({ name, holder, locked }) => [name, holder, locked]));
    const isShown = this.list.parentElement?.checkVisibility() === true; // an empty list is not visible
    if (key === this.known || now - this.loadedAt < INTERVAL_MS || !isShown) return;
    this.known = key;
    this.loadedAt = now;
    void this.load();
  }

  private async load(): Promise<void> {
    try {
      const { drives, lost } = await rest<{ drives: DriveView[]; lost: number }>("GET", PATH);
      this.list.replaceChildren(...drives.map(makeItem));
      setText(this.state, lost > 0 ? `${lost} drives could not be saved; see the log of hostlink for the reason.` : "");
    } catch (error) {
      this.known = null;
      setText(this.state, reasonOf(error));
    }
  }
}

function makeItem(drive: DriveView): HTMLElement {
  const { robot, owner, address, began, seconds, fastest_m_s, fastest_rad_s, end } = drive;
  const when = dateText(new Date(began));
  const title = make("span", { class: "what" }, make("b", {}, driverText(owner, address)), make("i", {}, robot));
  const time = make("time", { datetime: began }, end === "" ? `since ${when}` : `${when}, for ${ageText(seconds)}`);
  const fastest = `up to ${digits(fastest_m_s, 2)} m/s, ${digits(fastest_rad_s, 2)} rad/s`;
  const why = end === "" ? make("span", { class: "still" }, DRIVES) : `ended: ${reasonText(end)}`;
  return make("li", {}, title, time, make("span", { class: "detail" }, `${fastest}; `, why));
}
