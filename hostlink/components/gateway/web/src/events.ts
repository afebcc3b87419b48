/**
 * The daemon's event stream, one HTTP response that does not end; requested again after a loss.
 *
 * Read by fetch, because an EventSource can neither send a token in a header nor report the reason of a refusal.
 */

import { Refused, refusalOf, request } from "./rest";
import { token } from "./token";
import { Delay } from "./delay";
import type { ClientView, LinkView, LogLine, RecordingNews, RobotView } from "./views";

const PATH = "api/events";
const CHECK_MS = 50;
const SILENT_MS = 650; // the daemon writes every 300 ms: with CHECK_MS, a dead network is noticed within 0.7 s
const ABORT_MS = 2000;
const RETRY_MS = 500;

/** Data by event name. */
export interface Handlers {
  robots: (data: { robots: RobotView[] }) => void;
  links: (data: { links: LinkView[] }) => void;
  clients: (data: { clients: ClientView[] }) => void;
  recordings: (news: RecordingNews) => void;
  log: (line: LogLine) => void;
}

export class Events {
  /** Whether the daemon is heard; null: not yet. */
  isHeard: boolean | null = null;

  heardAt = 0; // time of the last byte, or of the last attempt to connect, by the page's clock
  private newestAt: number | null = null; // time of the last byte; null: none yet
  private isLate = false;
  private readonly delay = new Delay();
  private attempt = new AbortController();
  private lastId = ""; // of the newest log line: the daemon continues after it

  constructor(
    private readonly handlers: Handlers,
    private readonly onHeard: () => void,
    private readonly onRefusal: (refused: Refused) => void,
    private readonly onRole: (role: string | null) => void,
  ) {}

  /** Age of the newest event in seconds; null: no noticeable delay. A slow connection delivers old states. */
  get late_s(): number | null {
    return this.isLate ? this.delay.at_ms(performance.now()) / 1000 : null;
  }

  /** Age of what the page shows in seconds, while nothing newer comes; null: it is up to date. */
  get age_s(): number | null {
    if (this.isHeard !== false) return this.late_s;
    return this.newestAt === null ? null : (performance.now() - this.newestAt) / 1000;
  }

  start(): void {
    void this.run();
    setInterval(() => this.check(), CHECK_MS);
    addEventListener("online", () => this.retryNow());
  }

  /** Reconnect: the network is back. */
  retryNow(): void {
    if (!this.isHeard) this.attempt.abort();
  }

  /** Reconnect with a new token. */
  beginAnew(): void {
    this.attempt.abort();
  }

  private async run(): Promise<never> {
    while (true) {
      this.attempt = new AbortController();
      this.heardAt = performance.now();
      this.delay.begin(this.heardAt);
      const tried = token();
      try {
        await this.read();
      } catch (error) {
        // A stream that is aborted for a new token may have been refused already.
        if (error instanceof Refused && tried === token()) this.onRefusal(error);
      }
      this.change(false);
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }

  /** Browsers use separate connections for responses without credentials: so streams leave the others free for a stop. */
  private async read(): Promise<void> {
    const headers: Record<string, string> = this.lastId ? { "Last-Event-ID": this.lastId } : {};
    const response = await request("GET", PATH, { signal: this.attempt.signal, credentials: "omit" }, headers);
    if (!response.ok || response.body === null) throw await refusalOf(response);
    this.onRole(response.headers.get("Hostlink-Role"));
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let pending = "";
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      this.heardAt = this.newestAt = performance.now();
      this.change(true);
      pending += part.value;
      const events = pending.split("\n\n");
      pending = events.pop() ?? "";
      for (const event of events) this.dispatch(event);
    }
  }

  private dispatch(event: string): void {
    if (event.startsWith(":")) this.delay.note(/^: sent ([\d.]+)$/.exec(event)?.[1], performance.now());
    const [, id, name, data] = /^(?:id: (.*)\n)?event: (\w+)\ndata: (.*)$/.exec(event) ?? [];
    if (id !== undefined) this.lastId = id;
    if (name === undefined || data === undefined || !(name in this.handlers)) return; // a comment, or an event of a newer daemon
    this.handlers[name as keyof Handlers](JSON.parse(data));
  }

  private check(): void {
    const now = performance.now();
    const silence_ms = now - this.heardAt;
    this.change(this.isHeard, this.delay.at_ms(now) > SILENT_MS);
    if (silence_ms > SILENT_MS) this.change(false);
    if (silence_ms > ABORT_MS) this.attempt.abort();
  }

  private change(isHeard: boolean | null, isLate = this.isLate): void {
    if (isHeard === this.isHeard && isLate === this.isLate) return;
    this.isHeard = isHeard;
    this.isLate = isLate;
    this.onHeard();
  }
}
