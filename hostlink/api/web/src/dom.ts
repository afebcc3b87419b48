/** The few things that are done with elements everywhere. */

/** The element that index.html has; a missing one is a mistake in it. */
export function find<T extends HTMLElement = HTMLElement>(selector: string): T {
  const found = document.querySelector<T>(selector);
  if (found === null) throw new Error(`index.html has no ${selector}`);
  return found;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Set a text only when it changes: screen readers read changes only. */
export function setText(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** A number with so many digits and a real minus; a dash for none. */
export function digits(value: number | null | undefined, count: number): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(count);
  return (Number(text) === 0 ? (0).toFixed(count) : text).replace("-", "−");
}

/** A value of this browser's that outlives the page; a browser may forbid to keep it. */
export function remembered(key: string, otherwise: string): string {
  try {
    return localStorage.getItem(`hostlink.${key}`) ?? otherwise;
  } catch {
    return otherwise;
  }
}

export function remember(key: string, value: string): void {
  try {
    localStorage.setItem(`hostlink.${key}`, value);
  } catch {
    return; // private windows of some browsers: then it holds until the page is left
  }
}
