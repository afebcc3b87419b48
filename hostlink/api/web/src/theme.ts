/** Light, dark, or as the system: the switch, and the colours for what is drawn on a canvas. */

import { find, remember, remembered, setText } from "./dom";

const THEMES = { system: "Auto", light: "Light", dark: "Dark" };
type Theme = keyof typeof THEMES;
const ORDER = Object.keys(THEMES) as Theme[];

const probe = document.createElement("span"); // a canvas knows no variables: an element's computed colour does

const colours = new Map<string, string>();

/** The colour of a variable of the style sheet, as it is now. */
export function colour(variable: string): string {
  return computedColour(`var(--${variable})`);
}

/** What a colour of a style sheet is now, for a canvas. */
export function computedColour(value: string): string {
  let found = colours.get(value);
  if (found === undefined) {
    probe.style.color = value;
    found = getComputedStyle(probe).color;
    colours.set(value, found);
  }
  return found;
}

/** `onChange` is called whenever colours are other than before. */
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
