/** Shown without robots: the addresses that devices connect to, and the command for a simulated robot. */

import { find, make } from "./dom";
import type { Fleet } from "./fleet";
import { rest } from "./rest";

const LOOPBACK = /^(localhost|127\..*|\[::1\])$/; // names of this computer that other computers cannot use

interface Address {
  host: string;
  port: number;
}

/** GET api/listening */
interface Listening {
  tcp: Address | null;
  udp: Address | null;
  serial: { port: string; bauds: number[] }[];
  simulate: string | null;
}

export class Waiting {
  private readonly where = find("#robots .ways");
  private isLoaded = false; // since the daemon was last heard

  constructor(private readonly fleet: Fleet) {}

  /** Request the addresses after each reconnect: the daemon may have been restarted with other ports. */
  show(): void {
    const { isHeard, isKnown, robots } = this.fleet;
    if (!isHeard) this.isLoaded = false;
    if (this.isLoaded || !isHeard || !isKnown || robots.length > 0) return;
    this.isLoaded = true;
    void this.load();
  }

  /** Show nothing without an answer: an older daemon does not tell its addresses. */
  private async load(): Promise<void> {
    try {
      const listening = await rest<Listening>("GET", "api/listening");
      this.where.replaceChildren(...ways(listening), ...simulation(listening));
    } catch {
      this.where.replaceChildren();
    }
  }
}

function ways({ tcp, udp, serial }: Listening): HTMLElement[] {
  const items: (Node | string)[][] = [];
  if (tcp) items.push(["rosserial over TCP: ", code(tcp)]);
  if (udp) items.push(["datagrams over UDP: ", code(udp)]);
  for (const { port, bauds } of serial)
    items.push(["on ", make("code", {}, port), ` at ${bauds.join(", ")} baud: plug it in`]);
  if (items.length === 0) return [make("p", {}, "This hostlink has no port for devices: check its settings.")];
  return [make("p", {}, "A device connects here:"), make("ul", {}, ...items.map((item) => make("li", {}, ...item)))];
}

function simulation({ simulate }: Listening): HTMLElement[] {
  if (simulate === null) return [];
  const words = simulate.split(" ").flatMap((word) => [" ", make("span", { class: "word" }, word)]);
  return [make("p", {}, "For a simulated robot, run this on hostlink's computer:", make("code", {}, ...words))];
}

/** The address for a device. For all addresses of the computer it is the one that this page uses, unless that is local. */
function code({ host, port }: Address): HTMLElement {
  const isAny = host === "0.0.0.0" || host === "::";
  if (isAny && LOOPBACK.test(location.hostname))
    return make("span", {}, make("code", {}, `port ${port}`), ", this computer");
  const name = isAny ? location.hostname : host.includes(":") ? `[${host}]` : host;
  return make("code", {}, `${name}:${port}`);
}
