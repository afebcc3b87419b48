/**
 * Keys drive while they are held, by their position on the keyboard: where the stick is visible, and not while the user
 * types.
 */

import type { Driving } from "./driving";
import { isStickShown } from "./joystick";
import { notice } from "./notice";
import { closeTop } from "./open";

type Way = [forward: number, turn: number, left: number];

const WAYS: Record<string, Way> = {
  ArrowUp: [1, 0, 0],
  KeyW: [1, 0, 0],
  ArrowDown: [-1, 0, 0],
  KeyS: [-1, 0, 0],
  ArrowLeft: [0, 1, 0],
  KeyA: [0, 1, 0],
  ArrowRight: [0, -1, 0],
  KeyD: [0, -1, 0],
  KeyQ: [0, 0, 1],
  KeyE: [0, 0, -1],
};

/** Events after which releases are not reported: another window, a browser menu, a drag out of the page. */
export const LOST = ["blur", "contextmenu", "dragstart"] as const;

const NO_SIDEWAYS = "The drive of this robot cannot move it sideways.";
const HIDDEN = "Keys drive only where the stick is visible.";
const HIDDEN_MS = 3000;

const FRAME = "[role=separator], .full"; // resize and maximise panels: no key on them drives

const TEXTS = new Set(["text", "password", "number", "search", "email", "url", "tel"]);

/** Space stops; L and Escape lock. Escape first closes what is open, unless this page drives: then it is a stop. */
export function connectKeys(driving: Driving, stop: () => void, lock: () => void): void {
  const held = new Map<string, Way>();
  const hold = () => {
    const sum = (part: 0 | 1 | 2) => Math.sign([...held.values()].reduce((total, way) => total + way[part], 0));
    if (held.size > 0) driving.hold("keys", { forward: sum(0), turn: sum(1), left: sum(2) });
    else driving.release("keys");
  };
  addEventListener(
    "keydown",
    (event) => {
      const isModified = event.ctrlKey || event.altKey || event.metaKey;
      if (isModified) lose(); // with modifiers a release may not be reported
      const isLock = event.code === "Escape" || (event.code === "KeyL" && !isModified && !isTyping(event.target));
      if (isLock || (event.code === "Space" && !isTyping(event.target))) {
        event.preventDefault();
        event.stopPropagation(); // Space stops also when a button has the focus
        if (event.repeat) return;
        if (!isLock) stop();
        else if (event.code !== "Escape" || driving.isHeld || !(leaveSearch(event.target) || closeTop())) lock();
      } else if (event.code in WAYS && !isModified && !isTaken(event)) {
        if (!isStickShown()) {
          if (!event.code.startsWith("Arrow")) notice("done", HIDDEN, HIDDEN_MS); // arrows scroll
          return;
        }
        event.preventDefault();
        if (event.repeat) return; // a key that was released, for example by leaving the window, must be pressed again
        const [forward, turn, left] = WAYS[event.code] ?? [0, 0, 0];
        // with Shift at its press, a key that turns moves sideways until it is released
        const isStrafe = event.shiftKey && driving.hasSideways;
        if (left !== 0 && !driving.hasSideways) {
          notice("done", NO_SIDEWAYS, HIDDEN_MS);
          return;
        }
        held.set(event.code, isStrafe ? [forward, 0, left || turn] : [forward, turn, left]);
        hold();
      }
    },
    { capture: true },
  );
  addEventListener("keyup", (event) => {
    if (event.code === "Space" && !isTyping(event.target)) event.preventDefault(); // Space would press the focused button
    if (held.delete(event.code)) hold();
  });
  const lose = () => {
    if (held.size === 0) return;
    held.clear();
    hold();
  };
  for (const lost of LOST) addEventListener(lost, lose);
  addEventListener("focusin", ({ target }) => {
    if ((isControl(target) && !isRadio(target)) || isFrame(target)) lose();
  });
  document.addEventListener("visibilitychange", lose);
}

/** Whether the focused element needs the key. Radio buttons and scrolling elements do not use letters. */
function isTaken({ target, code }: KeyboardEvent): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (isFrame(target)) return true;
  if (code.startsWith("Arrow")) return isControl(target) || target.matches("[role=menu] *, [tabindex]:focus-visible");
  return (isControl(target) && !isRadio(target)) || target.matches("[role=menu] *");
}

function isFrame(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.matches(FRAME);
}

function isControl(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.matches("input, select, textarea, [contenteditable]");
}

function isRadio(target: EventTarget | null): boolean {
  return target instanceof HTMLInputElement && target.type === "radio";
}

/** Empty and leave a field for a search, as browsers do. Return false for another element. */
function leaveSearch(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLInputElement) || target.type !== "search") return false;
  target.value = "";
  target.dispatchEvent(new Event("input"));
  target.blur();
  return true;
}

function isTyping(target: EventTarget | null): boolean {
  return target instanceof HTMLTextAreaElement || (target instanceof HTMLInputElement && TEXTS.has(target.type));
}
