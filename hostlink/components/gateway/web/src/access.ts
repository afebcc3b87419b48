/** Asks the user for a token when the daemon requires one, with the reason. */

import { find, setText } from "./dom";
import { addCloser } from "./open";
import { forPeople } from "./rest";
import { keepToken } from "./token";

export class Access {
  private readonly panel = find("#access");

  /** `onToken` is called when a new token was entered. */
  constructor(onToken: () => void) {
    const input = find<HTMLInputElement>("#access-token");
    find<HTMLFormElement>("#access form").addEventListener("submit", (event) => {
      event.preventDefault();
      keepToken(input.value.trim());
      input.value = "";
      this.panel.hidden = true;
      onToken();
    });
    find("#access-close").addEventListener("click", () => this.close());
    addCloser(() => !find("#access-close").hidden && this.close());
  }

  private close(): boolean {
    const isOpen = this.isShown;
    this.panel.hidden = true;
    return isOpen;
  }

  get isShown(): boolean {
    return !this.panel.hidden;
  }

  /** `isOptional`: the page works without a token, so the form can be closed. */
  show(title: string, reason: string, isOptional = false): void {
    setText(find("#access-title"), title);
    setText(find("#access-reason"), forPeople(reason));
    find("#access-close").hidden = !isOptional;
    if (!this.panel.hidden) return;
    this.panel.hidden = false;
    find("#access-token").focus();
  }
}
