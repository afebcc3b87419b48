/**
 * Shown without robots: where boards connect to this daemon, what came in the last minute, what to set on the most
 * common boards, and the findings of `hostlink doctor`.
 */

import "./style/waiting.css";
import { ageText, find, make } from "./dom";
import type { Fleet } from "./fleet";
import { rest } from "./rest";

const AGAIN_MS = 2000;
const HEARD = "Received in the last minute";
const LOOPBACK = /^(localhost|127\..*|\[?::1\]?)$/; // names of this computer that other computers cannot use
const ANY = ["0.0.0.0", "::"]; // all addresses of the computer
const TRIED_BAUD = 57600; // of ros_lib
const SERIAL = `/dev/ttyACM0@${TRIED_BAUD}`;
const MICRO_ROS = "udp://0.0.0.0:8888";

interface Address {
  host: string;
  port: number;
}

/** GET api/listening */
interface Listening {
  tcp: Address | null;
  udp: Address | null;
  micro_ros?: string[]; // addresses such as udp://0.0.0.0:8888
  serial: { port: string; bauds: number[] }[];
  simulate: string | null;
  address?: string | null; // of hostlink's computer in its network
}

interface Finding {
  code: string;
  cause: string;
  next_step: string;
  detail: string;
}

/** GET api/diagnosis */
interface Diagnosis {
  findings: Finding[];
  arrivals: { way: string; peer: string; text: string; count: number; ago_s: number; diagnosis: Finding[] }[];
}

export class Waiting {
  private readonly ways = find("#robots .ways");
  private readonly heard = make("div", { class: "heard" });
  private readonly found = make("div", { class: "found" });
  private isAsking = false;
  private askedAt = Number.NEGATIVE_INFINITY;

  constructor(private readonly fleet: Fleet) {
    this.ways.after(this.heard, this.found);
    find("#robots .empty").tabIndex = 0; // keys scroll it
  }

  /** Ask at once after a reconnect: the daemon may have been restarted with other ports. */
  show(): void {
    const { isHeard, isKnown, robots } = this.fleet;
    if (!isHeard) this.askedAt = Number.NEGATIVE_INFINITY;
    if (isHeard && isKnown && robots.length === 0) void this.ask();
  }

  private async ask(): Promise<void> {
    if (this.isAsking || document.hidden || performance.now() < this.askedAt + AGAIN_MS) return;
    this.isAsking = true;
    this.askedAt = performance.now();
    await Promise.all([this.showPorts(), this.diagnose()]);
    this.isAsking = false;
  }

  /** Show nothing without an answer: an older daemon does not tell its addresses. */
  private async showPorts(): Promise<void> {
    try {
      const listening = await rest<Listening>("GET", "api/listening");
      replace(this.ways, [...ways(listening), boards(listening)]);
    } catch {
      replace(this.ways, []);
    }
  }

  private async diagnose(): Promise<void> {
    try {
      const { findings, arrivals } = await rest<Diagnosis>("GET", "api/diagnosis");
      replace(this.heard, heard(arrivals));
      replace(
        this.found,
        findings.length > 0 ? [make("h3", {}, "Findings of hostlink doctor"), list(findings.map(finding))] : [],
      );
    } catch {
      replace(this.heard, []);
      replace(this.found, []);
    }
  }
}

/** Replace the content only when it changes, so that a text can be selected. */
function replace(box: HTMLElement, content: HTMLElement[]): void {
  const next = make("div", {}, ...content);
  if (next.innerHTML !== box.innerHTML) box.replaceChildren(...next.childNodes);
}

function ways({ tcp, udp, micro_ros, serial }: Listening): HTMLElement[] {
  const items: (Node | string)[][] = [];
  if (tcp) items.push(["rosserial over TCP: ", ...where(tcp)]);
  if (udp) items.push(["datagrams over UDP: ", ...where(udp)]);
  for (const { way, ...address } of (micro_ros ?? []).map(parsed))
    items.push([`micro-ROS over ${way}: `, ...where(address)]);
  for (const { port, bauds } of serial)
    items.push(["on ", make("code", {}, port), ` at ${bauds.join(", ")} baud: plug it in`]);
  if (items.length === 0) return [make("p", {}, "This hostlink has no port for devices: check its settings.")];
  return [make("h3", {}, "Ports for devices"), list(items)];
}

/** What to set on the most common boards, with this daemon's addresses. */
function boards({ tcp, micro_ros, serial, simulate, address }: Listening): HTMLElement {
  const usb = serial[0];
  const serve = (port: string) => code(`hostlink serve --serial ${port}`);
  const arduino = usb
    ? ["plug it in as ", code(usb.port), `; its sketch uses ${usb.bauds.join(" or ")} baud`]
    : ["start ", serve(SERIAL), " on hostlink's computer, and plug it in"];
  const uart = ["wire TX, RX and ground to a USB adapter; ", serve(SERIAL.replace("ACM", "USB"))];
  const rows: [string, (Node | string)[]][] = [
    ["Arduino over USB", arduino],
    ["ESP8266, ESP32 over WiFi", wifi(tcp, address)],
    ["STM32 or another UART", uart],
  ];
  const port = (micro_ros ?? []).map(parsed)[0];
  if (port !== undefined) rows.push(["A micro-ROS board", microRos(port, address)]);
  if (simulate !== null) rows.push(["No board: a simulated robot", ["on hostlink's computer, ", code(simulate)]]);
  const terms = rows.flatMap(([name, what]) => [make("dt", {}, name), make("dd", {}, ...what)]);
  return make("div", { class: "boards" }, make("h3", {}, "What to set on the board"), make("dl", {}, ...terms));
}

interface MicroRosAddress extends Address {
  way: string;
}

/** An address such as udp://[::]:8888. */
function parsed(text: string): MicroRosAddress {
  const [, way, host, port] = /^(\w+):\/\/\[?(.*?)\]?:(\d+)$/.exec(text) ?? ["", "", text, "0"];
  return { way: way.toUpperCase(), host, port: Number(port) };
}

function microRos(port: MicroRosAddress, own: string | null | undefined): (Node | string)[] {
  const serve = code(`hostlink serve --micro-ros ${MICRO_ROS}`);
  if (LOOPBACK.test(port.host)) return ["hostlink listens for it on this computer only: start ", serve];
  const host = reached(port.host, own);
  if (host === null) return ["hostlink's computer is in no network; the port is ", code(String(port.port))];
  return ["set as its agent ", code(host), ` port ${port.port}, ${port.way}`];
}

/** The address of hostlink's computer for a device; null if it is in no network. */
function reached(host: string, own: string | null | undefined): string | null {
  return ANY.includes(host) ? (own ?? (isLocal() ? null : location.hostname)) : host;
}

function wifi(tcp: Address | null, own: string | null | undefined): (Node | string)[] {
  if (tcp === null) return ["hostlink has no TCP port: add ", code("[tcp]"), " to its settings"];
  if (LOOPBACK.test(tcp.host)) {
    return ["hostlink listens on this computer only: set ", code('[tcp] host = "0.0.0.0"'), " in its settings"];
  }
  const host = reached(tcp.host, own);
  const port = `, ${tcp.port}`;
  if (host === null) return ["hostlink's computer is in no network; the port is ", code(String(tcp.port))];
  const parts = /^(\d+)\.(\d+)\.(\d+)\.(\d+)$/.exec(host)?.slice(1);
  const server = parts ? `IPAddress(${parts.join(", ")})` : host;
  return ["in its sketch, ", code(`nh.getHardware()->setConnection(${server}${port});`)];
}

function heard(arrivals: Diagnosis["arrivals"]): HTMLElement[] {
  if (arrivals.length === 0) return [make("h3", {}, HEARD), make("p", {}, "Nothing was received.")];
  const items = arrivals.map(({ way, peer, text, count, ago_s, diagnosis }) => {
    const when = `${count > 1 ? `${count} times, the last ` : ""}${ageText(ago_s)} ago`;
    const facts = `${way === "serial" ? "" : `${way.toUpperCase()} `}${peer}: ${text} (${when})`;
    return [facts, ...diagnosis.map((each) => make("div", {}, ...finding(each)))];
  });
  return [make("h3", {}, HEARD), list(items)];
}

function finding({ cause, detail, next_step }: Finding): (Node | string)[] {
  return [make("b", {}, `${cause}${detail && ` (${detail})`}`), make("span", {}, ` Next: ${next_step}.`)];
}

function list(items: (Node | string)[][]): HTMLElement {
  return make("ul", {}, ...items.map((item) => make("li", {}, ...item)));
}

function isLocal(): boolean {
  return LOOPBACK.test(location.hostname);
}

/** The address for a device. For all addresses of the computer it is the one that this page uses, unless that is local. */
function where({ host, port }: Address): (Node | string)[] {
  const isAny = ANY.includes(host);
  if (isAny && isLocal()) return [code(`port ${port}`), ", this computer"];
  const name = isAny ? location.hostname : host.includes(":") ? `[${host}]` : host;
  return [code(`${name}:${port}`)];
}

/** Words that are not broken over lines, unless one is longer than the line. */
function code(text: string): HTMLElement {
  const words = text.split(" ").map((word) => make("span", { class: "word" }, word));
  return make("code", {}, ...words.flatMap((word, index) => (index === 0 ? [word] : [" ", word])));
}
