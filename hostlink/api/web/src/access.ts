/** Requests a token from the person when the daemon needs one, with the reason. */

import { find, setText } from "./dom";
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

  get isShown(): boolean {
    return !this.panel.hidden;
  }

  show(title: string, reason: string): void {
    setText(find("#access-title"), title);
    setText(find("#access-reason"), reason.replace(/^[A-Z]+ \/\S*: /, "")); // a person does not know the path
    if (!this.panel.hidden) return;
    this.panel.hidden = false;
    find("#access-token").focus();
  }
}
