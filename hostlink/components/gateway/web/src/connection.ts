/**
 * The WebSocket to rosbridge, probed by a service call three times a second, and reopened after a loss.
 *
 * Each attempt is a new socket. Nothing is queued for later: a command from before a loss must not reach a robot after
 * it.
 */

const CHECK_MS = 50;
const PROBE_MS = 300;
const LATE_MS = 400; // with PROBE_MS and twice CHECK_MS, a dead network is noticed within 0.8 s
const DEAD_MS = 2000;
const OPEN_MS = 1500;
const CALL_MS = 5000;
const MAX_CALLS = 32; // pending calls
const BACKOFF_MS = [250, 500, 1000];

const PUBLISH_ID = "publish:"; // followed by the topic: the id under which a refusal is reported
const DRIVE_ID = "drive";
const PROBE_ID = "probe";

/** hostlink's own operation in rosbridge: a velocity command that is answered, and refused when it is late. */
export interface DriveRequest {
  robot: string;
  linear: number;
  linear_y: number; // to the left
  angular: number;
  priority: number;
  epoch: number | null; // of the robot when this motion began; null: its first command is not answered yet
  take_over: boolean; // from another source of the same priority
  sent_s: number;
}

export interface DriveAnswer {
  result: boolean;
  kind?: string; // of a refusal: docs/robot.md
  reason?: string;
  by?: string | null; // who refuses it, or what disarmed this page: "a stop by teleop"
  epoch?: number;
  client?: string; // name of this connection, of an accepted command
  is_limited?: boolean;
}

/** late: no answer arrives; the network may only be slow. */
export type State = "connecting" | "open" | "late" | "closed";

interface Subscription {
  id: string;
  topic: string;
  type: string;
  throttle_ms: number;
  onMessage: (message: never) => void;
}

interface Call {
  resolve: (values: unknown) => void;
  reject: (error: Error) => void;
}

/** A message from the daemon, as far as this page reads it. */
type Incoming =
  | { op: "publish"; topic: string; msg: never }
  | { op: "service_response"; id?: string; result?: boolean; values?: unknown }
  | { op: "status"; id?: string; msg?: unknown }
  | ({ op: "drive_result" } & DriveAnswer)
  | { op: "other" };

export class Connection {
  state: State = "connecting";

  private socket: WebSocket | null = null;
  private readonly subscriptions = new Map<string, Subscription>(); // by id
  private subscribed = 0; // number of subscriptions so far: the next id
  private readonly calls = new Map<string, Call>(); // by id
  private called = 0;
  private probedAt: number | null = null; // null: the last probe was answered
  private answeredMs: number | null = null; // round trip of the last probe; null: unknown
  private probeAt = 0;
  private attemptAt = 0;
  private failures = 0;

  /** `address` is called at each attempt, because the token may have changed. */
  constructor(
    private readonly address: () => string,
    private readonly onState: (state: State) => void,
    private readonly onDriven: (answer: DriveAnswer) => void,
    private readonly onRefusal: (reason: string, topic: string) => void,
  ) {}

  /** Round trip to hostlink; for a pending probe its age. null: unknown. */
  get roundTripMs(): number | null {
    if (this.answeredMs === null || this.probedAt === null) return this.answeredMs;
    return Math.max(this.answeredMs, performance.now() - this.probedAt);
  }

  start(): void {
    this.open();
    setInterval(() => this.check(), CHECK_MS);
    addEventListener("online", () => this.retryNow());
    addEventListener("offline", () => this.drop());
  }

  /** Reconnect at once: the network is back. */
  retryNow(): void {
    if (this.state !== "open") this.beginAnew();
  }

  /** Reconnect at once with a new token: a connection has the rights of the token with which it was opened. */
  beginAnew(): void {
    this.drop();
    this.failures = 0;
    this.attemptAt = 0;
  }

  /** Subscribe until the returned function is called, also after reconnects. `throttle_ms`: shortest time between messages. */
  subscribe<T>(topic: string, type: string, onMessage: (message: T) => void, throttle_ms = 0): () => void {
    const id = `subscription:${++this.subscribed}`;
    const subscription = { id, topic, type, throttle_ms, onMessage: onMessage as (message: never) => void };
    this.subscriptions.set(id, subscription);
    this.request(subscription);
    return () => {
      if (this.subscriptions.delete(id)) this.send({ op: "unsubscribe", id, topic });
    };
  }

  /** Publish now; return false when it was not sent. */
  publish(topic: string, msg: object): boolean {
    return this.send({ op: "publish", id: PUBLISH_ID + topic, topic, msg });
  }

  /** Call a service and return its values; an error has the reason of a failure. */
  call<T>(service: string, args: object): Promise<T> {
    const id = `call:${++this.called}`;
    return new Promise<T>((resolve, reject) => {
      if (this.calls.size >= MAX_CALLS || !this.send({ op: "call_service", id, service, args })) {
        reject(new Error("hostlink is not connected."));
        return;
      }
      this.calls.set(id, { resolve: resolve as (values: unknown) => void, reject });
      setTimeout(() => this.answered(id, false, "hostlink does not answer."), CALL_MS);
    });
  }

  private answered(id: string, isDone: boolean, values: unknown): void {
    const call = this.calls.get(id);
    this.calls.delete(id);
    if (isDone) call?.resolve(values);
    else call?.reject(new Error(String(values)));
  }

  /** Send now; return false when it was not sent. */
  drive(request: DriveRequest): boolean {
    return this.send({ op: "drive", id: DRIVE_ID, ...request });
  }

  private send(message: object): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN || (this.state !== "open" && this.state !== "late")) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  private open(): void {
    const socket = new WebSocket(this.address());
    this.socket = socket;
    this.attemptAt = performance.now();
    this.change("connecting");
    socket.addEventListener("open", () => this.opened(socket));
    socket.addEventListener("close", () => this.closed(socket));
    socket.addEventListener("message", ({ data }) => {
      if (socket === this.socket && typeof data === "string") this.receive(JSON.parse(data) as Incoming);
    });
  }

  private opened(socket: WebSocket): void {
    if (socket !== this.socket) return;
    this.failures = 0;
    this.probedAt = null;
    this.probeAt = 0;
    this.change("open");
    this.send({ op: "set_level", level: "error" });
    for (const subscription of this.subscriptions.values()) this.request(subscription);
  }

  private closed(socket: WebSocket | null): void {
    if (socket !== this.socket || this.state === "closed") return;
    this.socket = null;
    this.answeredMs = null;
    this.attemptAt = performance.now() + (BACKOFF_MS[Math.min(this.failures, BACKOFF_MS.length - 1)] ?? 0);
    this.failures += 1;
    this.change("closed");
  }

  private drop(): void {
    const { socket } = this;
    this.closed(socket);
    socket?.close();
  }

  private receive(message: Incoming): void {
    if (message.op === "publish") {
      for (const { topic, onMessage } of this.subscriptions.values()) {
        if (topic === message.topic) onMessage(message.msg);
      }
    } else if (message.op === "drive_result") this.onDriven(message);
    else if (message.op === "service_response" && message.id === PROBE_ID) this.probed();
    else if (message.op === "service_response") {
      this.answered(message.id ?? "", message.result !== false, message.values);
    } else if (message.op === "status" && message.id?.startsWith(PUBLISH_ID)) {
      this.onRefusal(String(message.msg ?? ""), message.id.slice(PUBLISH_ID.length));
    }
  }

  private request({ id, topic, type, throttle_ms }: Subscription): void {
    this.send({ op: "subscribe", id, topic, type, throttle_rate: throttle_ms });
  }

  private check(): void {
    const now = performance.now();
    if (this.state === "closed") {
      if (now >= this.attemptAt) this.open();
    } else if (this.state === "connecting") {
      if (now >= this.attemptAt + OPEN_MS) this.drop();
    } else if (this.probedAt === null) {
      if (now >= this.probeAt) this.probe(now);
    } else if (now >= this.probedAt + DEAD_MS) {
      this.drop();
    } else if (now >= this.probedAt + LATE_MS) {
      this.change("late");
    }
  }

  private probe(now: number): void {
    this.probedAt = now;
    this.probeAt = now + PROBE_MS;
    this.send({ op: "call_service", id: PROBE_ID, service: "/rosapi/get_time", args: {} });
  }

  private probed(): void {
    if (this.probedAt === null) return;
    this.answeredMs = performance.now() - this.probedAt;
    this.probedAt = null;
    this.change("open");
  }

  private change(state: State): void {
    if (state === this.state) return;
    this.state = state;
    this.onState(state);
  }
}
