/** The theme: light, dark, or the system's, with the colours for canvases. */

import { find, remember, remembered, setText } from "./dom";

const THEMES = { system: "Auto", light: "Light", dark: "Dark" };
type Theme = keyof typeof THEMES;
const ORDER = Object.keys(THEMES) as Theme[];

const probe = document.createElement("span"); // a canvas cannot use variables, but an element's computed colour can

const colours = new Map<string, string>();

/** The present colour of a variable of the style sheet. */
export function colour(variable: string): string {
  return computedColour(`var(--${variable})`);
}

/** The present value of a style sheet's colour, for a canvas. */
export function computedColour(value: string): string {
  let found = colours.get(value);
  if (found === undefined) {
    probe.style.color = value;
    found = getComputedStyle(probe).color;
    colours.set(value, found);
  }
  return found;
}

/** `onChange` is called when the colours changed. */
export function connectTheme(onChange: () => void): void {
  const change = () => {
    colours.clear();
    onChange();
  };
  probe.hidden = true;
  document.body.append(probe);
  const button = find<HTMLButtonElement>("#theme");
  const apply = (theme: Theme) => {
    document.documentElement.dataset.theme = theme;
    setText(find("#theme .label"), THEMES[theme]);
    button.setAttribute("aria-label", `Colours: ${THEMES[theme]}`);
    change();
  };
  let theme = ORDER.find((each) => each === remembered("theme", "system")) ?? "system";
  apply(theme);
  button.addEventListener("click", () => {
    theme = ORDER[(ORDER.indexOf(theme) + 1) % ORDER.length] ?? "system";
    remember("theme", theme);
    apply(theme);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", change);
}
