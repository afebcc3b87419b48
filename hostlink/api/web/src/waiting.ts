/** What is shown while there is no robot: where one connects, and how to run a simulated one. */

import { find, make } from "./dom";
import type { Fleet } from "./fleet";
import { rest } from "./rest";

const LOOPBACK = /^(localhost|127\..*|\[::1\])$/; // a name of this computer that no other one knows it by

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
  private isLoaded = false; // since the daemon was heard

  constructor(private readonly fleet: Fleet) {}

  /** Ask the daemon once whenever it is there again: it may have been started with other ports. */
  show(): void {
    const { isHeard, isKnown, robots } = this.fleet;
    if (!isHeard) this.isLoaded = false;
    if (this.isLoaded || !isHeard || !isKnown || robots.length > 0) return;
    this.isLoaded = true;
    void this.load();
  }

  /** Without an answer nothing is claimed: an older daemon does not say where it listens. */
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
  if (items.length === 0) return [make("p", {}, "This hostlink listens for no device: see its settings.")];
  return [make("p", {}, "A device connects here:"), make("ul", {}, ...items.map((item) => make("li", {}, ...item)))];
}

function simulation({ simulate }: Listening): HTMLElement[] {
  if (simulate === null) return [];
  const words = simulate.split(" ").flatMap((word) => [" ", make("span", { class: "word" }, word)]);
  return [make("p", {}, "Without one at hand, run this on hostlink's computer: ", make("code", {}, ...words))];
}

/** As a device has to be told: of all addresses of the computer, the one that this page is from, if others know it. */
function code({ host, port }: Address): HTMLElement {
  const isAny = host === "0.0.0.0" || host === "::";
  if (isAny && LOOPBACK.test(location.hostname))
    return make("span", {}, make("code", {}, `port ${port}`), ", this computer");
  const name = isAny ? location.hostname : host.includes(":") ? `[${host}]` : host;
  return make("code", {}, `${name}:${port}`);
}
