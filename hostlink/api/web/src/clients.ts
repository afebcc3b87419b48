/** Who else is connected, if the daemon tells. */

import { find, make } from "./dom";
import { Refused, rest } from "./rest";
import type { ClientView } from "./views";

const INTERVAL_MS = 2000;
const BROWSERS = ["Firefox", "Edg", "Chrome", "Safari"]; // each says the names of the later ones too

export function showClients(): void {
  const panel = find("#clients");
  const list = find("#clients ul");
  const look = async () => {
    try {
      const { clients } = await rest<{ clients: ClientView[] }>("GET", "api/clients");
      panel.hidden = false;
      list.replaceChildren(...clients.map(describe));
    } catch (error) {
      panel.hidden = true;
      if (error instanceof Refused && error.status === 404) return; // a daemon that does not tell
    }
    setTimeout(look, INTERVAL_MS);
  };
  void look();
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
