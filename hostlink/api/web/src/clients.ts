/** Clients that are connected to hostlink. */

import { find, make } from "./dom";
import type { ClientView } from "./views";

const BROWSERS = ["Firefox", "Edg", "Chrome", "Safari"]; // each user agent also contains the later names

/** A page is listed once, although it has an event stream and a WebSocket. */
export function showClients(clients: ClientView[]): void {
  const programs = new Set(clients.filter(({ kind }) => kind !== "events").map(programOf));
  const shown = clients.filter((client) => client.kind !== "events" || !programs.has(programOf(client)));
  find("#clients ul").replaceChildren(...shown.map(describe));
}

function programOf({ peer, program }: ClientView): string {
  return `${peer} ${program}`;
}

function describe(client: ClientView): HTMLElement {
  const trouble = client.dropped > 0 ? `${client.dropped} dropped` : "";
  const program = BROWSERS.find((name) => client.program.includes(`${name}/`)) ?? client.program.split(/[ /]/)[0] ?? "";
  return make(
    "li",
    { title: client.program },
    make("b", {}, client.name),
    make("span", {}, [client.peer, client.role, program].filter(Boolean).join(" · ")),
    make("em", {}, trouble),
  );
}
