/** Clients that are connected to hostlink. */

import { find, make } from "./dom";
import { type ClientView, named } from "./views";

const programs = new Map<string, string>(); // by the name of the client

const BROWSERS = ["Firefox", "Edg", "Chrome", "Safari"]; // each user agent also contains the later names

/** A page is listed once, although it has an event stream and a WebSocket. */
export function showClients(clients: ClientView[]): void {
  for (const { name, kind, program } of clients) if (kind !== "events") programs.set(name, programText(program));
  const known = new Set(clients.filter(({ kind }) => kind !== "events").map(programOf));
  const shown = clients.filter((client) => client.kind !== "events" || !known.has(programOf(client)));
  find("#clients ul").replaceChildren(...shown.map(describe));
}

function programOf({ peer, program }: ClientView): string {
  return `${peer} ${program}`;
}

/** Who drives, for people: `Chrome (client 3, 10.0.0.5)`, if its client is or was connected while the page is open. */
export function driverText(owner: string, address: string | null | undefined): string {
  const [, peer] = /^rest (.+)$/.exec(owner) ?? [];
  if (peer !== undefined) return `a REST request from ${peer}`;
  const program = programs.get(owner);
  if (!program || owner.includes(`(${program})`)) return named(owner, address); // a page is named after its browser
  return `${program === "Edg" ? "Edge" : program} (${[owner, address].filter(Boolean).join(", ")})`;
}

function programText(program: string): string {
  return BROWSERS.find((name) => program.includes(`${name}/`)) ?? program.split(/[ /]/)[0] ?? "";
}

function describe(client: ClientView): HTMLElement {
  const trouble = client.dropped > 0 ? `${client.dropped} dropped` : "";
  const program = programText(client.program);
  return make(
    "li",
    { title: client.program },
    make("b", {}, client.name),
    make("span", {}, [client.peer, client.role, program].filter(Boolean).join(" · ")),
    make("em", {}, trouble),
  );
}
