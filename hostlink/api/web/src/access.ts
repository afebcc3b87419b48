/** Asks for a token when the daemon wants one, and says why. */

import { find, say } from "./dom";
import { keepToken } from "./token";

export class Access {
  private readonly panel = find("#access");

  /** `onToken`: there is another one now. */
  constructor(onToken: () => void) {
    const input = find<HTMLInputElement>("#access-token");
    find<HTMLFormElement>("#access form").addEventListener("submit", (event) => {
      event.preventDefault();
      keepToken(input.value.trim());
      input.value = "";
      this.panel.hidden = true;
      onToken();
    });
  }

  get isAsking(): boolean {
    return !this.panel.hidden;
  }

  ask(title: string, reason: string): void {
    say(find("#access-title"), title);
    say(find("#access-reason"), reason.replace(/^[A-Z]+ \/\S*: /, "")); // what was asked for is no news here
    if (!this.panel.hidden) return;
    this.panel.hidden = false;
    find("#access-token").focus();
  }
}
