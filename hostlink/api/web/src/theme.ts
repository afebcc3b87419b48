/** Light, dark, or as the system: the switch, and the colours for what is drawn on a canvas. */

import { find, remember, remembered, say } from "./dom";

const THEMES = { system: "Auto", light: "Light", dark: "Dark" };
type Theme = keyof typeof THEMES;
const ORDER = Object.keys(THEMES) as Theme[];

const probe = document.createElement("span"); // a canvas knows no variables: an element's computed colour does

/** The colour of a variable of style.css, as it is now. */
export function colour(variable: string): string {
  probe.style.color = `var(--${variable})`;
  return getComputedStyle(probe).color;
}

/** `onChange` is called whenever colours are other than before. */
export function connectTheme(onChange: () => void): void {
  probe.hidden = true;
  document.body.append(probe);
  const button = find<HTMLButtonElement>("#theme");
  const apply = (theme: Theme) => {
    document.documentElement.dataset.theme = theme;
    say(find("#theme .label"), THEMES[theme]);
    button.setAttribute("aria-label", `Colours: ${THEMES[theme]}`);
    onChange();
  };
  let theme = ORDER.find((each) => each === remembered("theme", "system")) ?? "system";
  apply(theme);
  button.addEventListener("click", () => {
    theme = ORDER[(ORDER.indexOf(theme) + 1) % ORDER.length] ?? "system";
    remember("theme", theme);
    apply(theme);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", onChange);
}
