/** The recordings panel: start and stop recordings, watch their progress, download and remove files. */

import "./style/recordings.css";
import { arrange, confirmed, make, setText } from "./dom";
import { makeDownload } from "./download";
import type { Page } from "./page";
import { reasonOf, refusalOf, request, rest } from "./rest";
import { StoredWindow } from "./stored";
import { dateText } from "./times";
import type { RecordingNews, RecordingView } from "./views";
import { bytes, duration, makeButton, makeField } from "./widgets";

const MAX_SHOWN = 100; // files
const STOP_TIMEOUT_MS = 15_000; // the last chunk is written to the disk
const PATH = "api/recordings";

interface StoredView {
  file: string;
  bytes: number;
  modified: string;
  is_open: boolean;
}

export function startRecordings(page: Page): HTMLElement {
  const panel = new Recordings(page);
  page.onRecordings((news) => panel.show(news));
  return panel.root;
}

class Recordings {
  readonly root: HTMLElement;

  private readonly robots = make("select", {}, make("option", { value: "" }, "all robots"));
  private readonly topics = make("input", {
    type: "text",
    maxlength: "400",
    placeholder: "all, or some",
    title: "Names, or patterns as /robot_0/*",
  });
  private readonly start = make("button", { type: "submit", class: "main record" }, "Record");
  private readonly underWay = make("ul", { class: "underway" });
  private readonly files = make("ul", { class: "files" });
  private readonly state = make("p", { class: "hint", role: "status" });
  private readonly chosen = make("input", { type: "file", accept: ".mcap", hidden: "", "aria-label": "MCAP file" });
  private readonly openFile = makeButton("Open a file", () => this.chosen.click(), {
    "data-bar": "",
    title: "Copy an MCAP file from this computer into the recordings, and open it",
  });
  private readonly window = new StoredWindow();
  private readonly rows = new Map<string, { root: HTMLElement; figures: HTMLElement }>();
  private items = new Map<string, HTMLElement>();
  private known = "";
  private isUploading = false;

  constructor(private readonly page: Page) {
    const form = make("form", {}, makeField("Robots", this.robots), makeField("Topics", this.topics), this.start);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.begin();
    });
    this.chosen.addEventListener("change", () => {
      const file = this.chosen.files?.[0];
      this.chosen.value = ""; // the same file may be chosen again
      if (file) void this.upload(file);
    });
    const hint = make(
      "p",
      { class: "hint none" },
      "No file yet. A recording opens here, in Foxglove and by hostlink play.",
    );
    const parts = [this.openFile, this.chosen, form, this.state, this.underWay, this.files, hint];
    this.root = make("section", {}, ...parts);
    page.onShow(() => {
      this.showRights();
      this.showRobots();
      if (!page.fleet.isHeard) this.forget();
    });
  }

  /** Show running recordings, and load the files if they changed. */
  show({ recordings, changes }: RecordingNews): void {
    for (const [name, row] of this.rows) {
      if (recordings.some((each) => each.name === name)) continue;
      row.root.remove();
      this.rows.delete(name);
    }
    for (const each of recordings) setText(this.row(each.name).figures, figuresOf(each));
    const known = [changes, ...recordings.map(({ name }) => name)].join("\n");
    if (known === this.known && this.files.dataset.loaded) return;
    this.known = known;
    void this.load();
  }

  /** Note that the daemon is not heard: whether it still records is unknown until it is heard again. */
  private forget(): void {
    for (const { figures } of this.rows.values()) setText(figures, "no data");
  }

  /** Disable all controls that change something; opening and downloads remain. */
  private showRights(): void {
    const changing = this.root.querySelectorAll<HTMLButtonElement>("button:not(.reads, .fold, .more)");
    for (const button of changing)
      button.disabled = !this.page.canDrive || (button === this.openFile && this.isUploading);
  }

  private showRobots(): void {
    const names = ["", ...this.page.fleet.robots.map(({ name }) => name)];
    if (names.join("\n") === this.robots.dataset.names) return;
    this.robots.dataset.names = names.join("\n");
    const chosen = this.robots.value;
    this.robots.replaceChildren(...names.map((name) => make("option", { value: name }, name || "all robots")));
    this.robots.value = names.includes(chosen) ? chosen : "";
  }

  private row(name: string): { root: HTMLElement; figures: HTMLElement } {
    const known = this.rows.get(name);
    if (known) return known;
    const figures = make("span", { class: "figures" });
    const stop = makeButton("Stop recording", () => void this.end(name), { "aria-label": `Stop recording ${name}` });
    const root = make("li", {}, make("b", {}, name), figures, stop);
    const row = { root, figures };
    this.rows.set(name, row);
    this.underWay.append(root);
    this.showRights();
    return row;
  }

  private async begin(): Promise<void> {
    const robot = this.robots.value;
    const topics = this.topics.value.split(/[\s,]+/).filter(Boolean);
    await this.attempt(async () => {
      const body = { topics, robots: robot === "" ? [] : [robot] };
      const begun = await rest<RecordingView>("POST", PATH, body, STOP_TIMEOUT_MS);
      setText(this.row(begun.name).figures, figuresOf(begun));
    });
  }

  private async end(name: string): Promise<void> {
    await this.attempt(async () => {
      const path = `${PATH}/${encodeURIComponent(name)}/stop`;
      const ended = await rest<RecordingView>("POST", path, undefined, STOP_TIMEOUT_MS);
      setText(this.state, `${name}: ${figuresOf(ended)}`);
      this.rows.get(name)?.root.remove();
      this.rows.delete(name);
      await this.load();
    });
  }

  private async load(): Promise<void> {
    await this.attempt(async () => {
      const { files } = await rest<{ files: StoredView[] }>("GET", PATH);
      this.files.dataset.loaded = String(files.length);
      const closed = files.filter(({ is_open }) => !is_open);
      const before = this.items;
      this.items = new Map();
      for (const file of closed.slice(0, MAX_SHOWN)) {
        const key = `${file.file} ${file.bytes} ${file.modified}`;
        this.items.set(key, before.get(key) ?? this.makeFile(file)); // a button that was pressed once stays so
      }
      arrange(this.files, this.items.values());
      this.showRights();
    });
  }

  private makeFile({ file, bytes: size, modified }: StoredView): HTMLElement {
    const when = dateText(new Date(modified));
    const remove = make("button", { type: "button", "aria-label": `Remove ${file}` }, "Remove");
    confirmed(remove, "Remove it?", () => () => void this.remove(file));
    const facts = make("span", { class: "figures" }, `${bytes(size)} · ${when}`);
    const open = makeButton("Open", () => void this.open(file, open), { class: "reads", "aria-label": `Open ${file}` });
    return make(
      "li",
      {},
      make("b", {}, file),
      facts,
      open,
      makeDownload(`${PATH}/${encodeURIComponent(file)}`, file),
      remove,
    );
  }

  private async open(file: string, opener: HTMLElement): Promise<void> {
    await this.attempt(() => this.window.openRecording(file, opener));
  }

  /** Copy a file into the recordings of the daemon, which reads it, and open it. */
  private async upload(file: File): Promise<void> {
    const name = nameOf(file.name);
    this.isUploading = true;
    this.showRights();
    setText(this.state, `Copying ${file.name}, ${bytes(file.size)} …`);
    await this.attempt(async () => {
      const response = await request("PUT", `${PATH}/${encodeURIComponent(name)}`, { body: file });
      if (!response.ok) throw await refusalOf(response);
      setText(this.state, `${name}.mcap is among the recordings.`);
      await this.load();
      await this.window.openRecording(`${name}.mcap`, this.openFile);
    });
    this.isUploading = false;
    this.showRights();
  }

  private async remove(file: string): Promise<void> {
    await this.attempt(async () => {
      await rest("DELETE", `${PATH}/${encodeURIComponent(file)}`);
      setText(this.state, `${file} is removed.`);
      await this.load();
    });
  }

  private async attempt(work: () => Promise<void>): Promise<void> {
    try {
      await work();
    } catch (error) {
      setText(this.state, reasonOf(error));
    }
  }
}

/** A recording's name: letters, digits and . _ + - of the file's name. */
function nameOf(file: string): string {
  const plain = file.replace(/\.mcap$/i, "").replace(/[^A-Za-z0-9_+-]+/g, "-");
  return plain.replace(/^[^A-Za-z0-9]+/, "").slice(0, 90) || "recording";
}

function figuresOf({ messages, bytes: size, seconds, dropped, failure }: RecordingView): string {
  const count = `${messages.toLocaleString("en")} message${messages === 1 ? "" : "s"}`;
  const figures = `${count} · ${bytes(size)} · ${duration(seconds)} · ${dropped} dropped`;
  return failure === undefined ? figures : `${figures} · ${failure}`;
}
