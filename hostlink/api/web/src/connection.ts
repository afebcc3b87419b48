/**
 * The WebSocket: rosbridge by roslib, watched by a question every now and then, and opened again for ever.
 *
 * Each attempt is a new Ros of its own: roslib keeps what is said while it is closed and says it later, and nothing
 * that was meant before a break may reach a robot after it.
 */

import { Ros, type RosbridgeMessage, Service, Topic, WebSocketTransportFactory } from "roslib";

const LOOK_MS = 50;
const ASK_MS = 300;
const LATE_MS = 400; // with ASK_MS, and LOOK_MS twice: a dead network is seen within 0.8 s
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

/** late: nothing comes back, it may only be slow. */
export type State = "connecting" | "open" | "late" | "closed";

interface Wish {
  topic: string;
  type: string;
  take: (message: never) => void;
}

export class Connection {
  state: State = "connecting";
  roundTripMs: number | null = null;

  private ros: Ros | null = null;
  private topics = new Map<Wish, Topic<never>>();
  private wishes = new Set<Wish>();
  private askedAt: number | null = null;
  private askAt = 0;
  private attemptAt = 0;
  private failures = 0;
  private serial = 0;

  /** `address` is asked at each attempt: the token may be new. */
  constructor(
    private readonly address: () => string,
    private readonly onState: (state: State) => void,
    private readonly onDriven: (answer: DriveAnswer) => void,
    private readonly onRefusal: (reason: string) => void,
  ) {}

  start(): void {
    this.open();
    setInterval(() => this.look(), LOOK_MS);
    addEventListener("online", () => this.retryNow());
    addEventListener("offline", () => this.drop());
  }

  /** Try again at once: there is a new token, or the network says that it is back. */
  retryNow(): void {
    if (this.state === "open") return;
    this.drop();
    this.failures = 0;
    this.attemptAt = 0;
  }

  /** Holds over every break until the returned function is called. */
  subscribe<T>(topic: string, type: string, take: (message: T) => void): () => void {
    const wish: Wish = { topic, type, take: take as (message: never) => void };
    this.wishes.add(wish);
    if (this.ros?.isConnected) this.fulfil(this.ros, wish);
    return () => {
      this.wishes.delete(wish);
      if (this.ros?.isConnected) this.topics.get(wish)?.unsubscribe();
      this.topics.delete(wish);
    };
  }

  /** Say it now or never: false when it was not said. */
  publish(topic: string, msg: object): boolean {
    return this.say({ op: "publish", id: PUBLISH_ID, topic, msg });
  }

  /** Say it now or never. */
  drive(request: DriveRequest): boolean {
    return this.say({ op: "drive", id: DRIVE_ID, ...request });
  }

  private say(message: object): boolean {
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
    this.askedAt = null;
    this.askAt = 0;
    ros.setStatusLevel("error");
    ros.on(`status:${PUBLISH_ID}`, (status) => this.onRefusal(textOf(status)));
    ros.on(`status:${DRIVE_ID}`, (status) => {
      this.onDriven({ result: false, kind: "NoRole", reason: textOf(status) });
    });
    this.topics.clear();
    for (const wish of this.wishes) this.fulfil(ros, wish);
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

  private fulfil(ros: Ros, wish: Wish): void {
    const topic = new Topic<never>({ ros, name: wish.topic, messageType: wish.type, reconnect_on_close: false });
    topic.subscribe(wish.take);
    this.topics.set(wish, topic);
  }

  private look(): void {
    const now = performance.now();
    if (this.state === "closed") {
      if (now >= this.attemptAt) this.open();
    } else if (this.state === "connecting") {
      if (now >= this.attemptAt + OPEN_MS) this.drop();
    } else if (this.askedAt === null) {
      if (now >= this.askAt) this.ask(now);
    } else if (now >= this.askedAt + DEAD_MS) {
      this.drop();
    } else if (now >= this.askedAt + LATE_MS) {
      this.change("late");
    }
  }

  private ask(now: number): void {
    const { ros, serial } = this;
    if (ros === null) return;
    this.askedAt = now;
    this.askAt = now + ASK_MS;
    const heard = () => {
      if (serial !== this.serial || this.askedAt === null) return;
      this.roundTripMs = performance.now() - this.askedAt;
      this.askedAt = null;
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
