/** Functions for elements. */

/** Return the element that index.html has. Throw if it is missing. */
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

/** Set a text only when it changes: screen readers announce changes. */
export function setText(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Replace the children. A child that remains is not moved, so that it keeps focus and pointer. */
export function arrange(list: Element, children: Iterable<Element>): void {
  const wanted = new Set(children);
  for (const old of [...list.children]) if (!wanted.has(old)) old.remove();
  let next = list.firstElementChild;
  for (const child of wanted) {
    if (child === next) next = next.nextElementSibling;
    else list.insertBefore(child, next);
  }
}

/** A number with this many decimal places and a minus sign; a dash for null. */
export function digits(value: number | null | undefined, count: number): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(count);
  return (Number(text) === 0 ? (0).toFixed(count) : text).replace("-", "−");
}

/** An age as a short text. */
export function ageText(age_s: number): string {
  if (age_s < 60) return `${digits(age_s, age_s < 10 ? 1 : 0)} s`;
  return age_s < 3600 ? `${digits(age_s / 60, 0)} min` : `${digits(age_s / 3600, 0)} h`;
}

/** A value that this browser keeps between visits, if the browser allows it. */
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
    return; // some browsers forbid it in private windows: the value holds until the page is closed
  }
}

const CONFIRM_MS = 4000;

/** A button that needs confirmation: `prepare` runs at the first press and returns the action of a second press soon after. */
export function confirmed(button: HTMLButtonElement, question: string, prepare: () => () => void): void {
  let timer: number | null = null;
  let act = () => {};
  const label = button.textContent;
  const end = () => {
    if (timer !== null) clearTimeout(timer);
    timer = null;
    setText(button, label);
    button.classList.remove("asking");
  };
  button.addEventListener("click", () => {
    if (timer !== null) {
      end();
      act();
      return;
    }
    act = prepare();
    timer = setTimeout(end, CONFIRM_MS);
    setText(button, question);
    button.classList.add("asking");
  });
  button.addEventListener("blur", end);
}
