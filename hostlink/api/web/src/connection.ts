/**
 * The WebSocket: rosbridge by roslib, probed by a service call three times a second, and opened again whenever it is
 * lost.
 *
 * Each attempt is a new Ros of its own: roslib keeps what is sent while it is closed and sends it later, and nothing
 * that was meant before a break may reach a robot after it.
 */

import { Ros, type RosbridgeMessage, Service, Topic, WebSocketTransportFactory } from "roslib";

const CHECK_MS = 50;
const PROBE_MS = 300;
const LATE_MS = 400; // with PROBE_MS, and CHECK_MS twice: a dead network is noticed within 0.8 s
const DEAD_MS = 2000;
const OPEN_MS = 1500;
const BACKOFF_MS = [250, 500, 1000];

const PUBLISH_ID = "publish"; // under these a refusal comes back
const DRIVE_ID = "drive";

/** hostlink's own operation beside rosbridge's: a command that is answered, and refused when it comes too late. */
export interface DriveRequest {
  robot: string;
  linear: number;
  angular: number;
  priority: number;
  link: number | null;
  sent_s: number;
}

export interface DriveAnswer {
  result: boolean;
  kind?: string;
  reason?: string;
  is_limited?: boolean;
}

/** late: no answer comes; the network may only be slow. */
export type State = "connecting" | "open" | "late" | "closed";

interface Subscription {
  topic: string;
  type: string;
  onMessage: (message: never) => void;
}

export class Connection {
  state: State = "connecting";
  roundTripMs: number | null = null;

  private ros: Ros | null = null;
  private topics = new Map<Subscription, Topic<never>>();
  private subscriptions = new Set<Subscription>();
  private probedAt: number | null = null; // null: it was answered
  private probeAt = 0;
  private attemptAt = 0;
  private failures = 0;
  private serial = 0;

  /** `address` is called at each attempt: the token may be new. */
  constructor(
    private readonly address: () => string,
    private readonly onState: (state: State) => void,
    private readonly onDriven: (answer: DriveAnswer) => void,
    private readonly onRefusal: (reason: string) => void,
  ) {}

  start(): void {
    this.open();
    setInterval(() => this.check(), CHECK_MS);
    addEventListener("online", () => this.retryNow());
    addEventListener("offline", () => this.drop());
  }

  /** Try again at once: there is a new token, or the network is back. */
  retryNow(): void {
    if (this.state === "open") return;
    this.drop();
    this.failures = 0;
    this.attemptAt = 0;
  }

  /** Holds over every break until the returned function is called. */
  subscribe<T>(topic: string, type: string, onMessage: (message: T) => void): () => void {
    const subscription: Subscription = { topic, type, onMessage: onMessage as (message: never) => void };
    this.subscriptions.add(subscription);
    if (this.ros?.isConnected) this.request(this.ros, subscription);
    return () => {
      this.subscriptions.delete(subscription);
      if (this.ros?.isConnected) this.topics.get(subscription)?.unsubscribe();
      this.topics.delete(subscription);
    };
  }

  /** Send it now or never: false when it was not sent. */
  publish(topic: string, msg: object): boolean {
    return this.send({ op: "publish", id: PUBLISH_ID, topic, msg });
  }

  /** Send it now or never. */
  drive(request: DriveRequest): boolean {
    return this.send({ op: "drive", id: DRIVE_ID, ...request });
  }

  private send(message: object): boolean {
    if (this.ros === null || (this.state !== "open" && this.state !== "late")) return false;
    this.ros.callOnConnection(message as RosbridgeMessage);
    return true;
  }

  private open(): void {
    const serial = ++this.serial;
    const ros = new Ros({
      transportFactory: async (url) => {
        const transport = await WebSocketTransportFactory(url);
        return transport.on("message", (message: object) => {
          if ("op" in message && message.op === "drive_result") this.onDriven(message as unknown as DriveAnswer);
        });
      },
    });
    this.ros = ros;
    this.attemptAt = performance.now();
    this.change("connecting");
    ros.on("connection", () => this.opened(serial, ros));
    ros.on("close", () => this.closed(serial));
    ros.on("error", () => this.closed(serial));
    ros.connect(this.address()).catch(() => this.closed(serial));
  }

  private opened(serial: number, ros: Ros): void {
    if (serial !== this.serial) {
      ros.close();
      return;
    }
    this.failures = 0;
    this.probedAt = null;
    this.probeAt = 0;
    ros.setStatusLevel("error");
    ros.on(`status:${PUBLISH_ID}`, (status) => this.onRefusal(textOf(status)));
    ros.on(`status:${DRIVE_ID}`, (status) => {
      this.onDriven({ result: false, kind: "NoRole", reason: textOf(status) });
    });
    this.topics.clear();
    for (const subscription of this.subscriptions) this.request(ros, subscription);
    this.change("open");
  }

  private closed(serial: number): void {
    if (serial !== this.serial || this.state === "closed") return;
    this.ros = null;
    this.roundTripMs = null;
    this.attemptAt = performance.now() + (BACKOFF_MS[Math.min(this.failures, BACKOFF_MS.length - 1)] ?? 0);
    this.failures += 1;
    this.change("closed");
  }

  private drop(): void {
    const ros = this.ros;
    this.closed(this.serial);
    ros?.close();
  }

  private request(ros: Ros, subscription: Subscription): void {
    const { topic: name, type: messageType, onMessage } = subscription;
    const topic = new Topic<never>({ ros, name, messageType, reconnect_on_close: false });
    topic.subscribe(onMessage);
    this.topics.set(subscription, topic);
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
    const { ros, serial } = this;
    if (ros === null) return;
    this.probedAt = now;
    this.probeAt = now + PROBE_MS;
    const heard = () => {
      if (serial !== this.serial || this.probedAt === null) return;
      this.roundTripMs = performance.now() - this.probedAt;
      this.probedAt = null;
      this.change("open");
    };
    new Service({ ros, name: "/rosapi/get_time", serviceType: "rosapi/GetTime" }).callService({}, heard, heard);
  }

  private change(state: State): void {
    if (state === this.state) return;
    this.state = state;
    this.onState(state);
  }
}

function textOf(status: RosbridgeMessage): string {
  return "msg" in status ? String(status.msg) : "";
}
