/** Requests a token from the person when the daemon needs one, with the reason. */

import { find, setText } from "./dom";
import { forPeople } from "./rest";
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
    find("#access-close").addEventListener("click", () => {
      this.panel.hidden = true;
    });
  }

  get isShown(): boolean {
    return !this.panel.hidden;
  }

  /** `isOptional`: the page is of use without one. */
  show(title: string, reason: string, isOptional = false): void {
    setText(find("#access-title"), title);
    setText(find("#access-reason"), forPeople(reason));
    find("#access-close").hidden = !isOptional;
    if (!this.panel.hidden) return;
    this.panel.hidden = false;
    find("#access-token").focus();
  }
}
