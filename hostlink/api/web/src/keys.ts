/** Keys drive while they are held, by their place on the keyboard, and not while somebody types. */

import type { Driving } from "./driving";

const WAYS: Record<string, [forward: number, turn: number]> = {
  ArrowUp: [1, 0],
  KeyW: [1, 0],
  ArrowDown: [-1, 0],
  KeyS: [-1, 0],
  ArrowLeft: [0, 1],
  KeyA: [0, 1],
  ArrowRight: [0, -1],
  KeyD: [0, -1],
};

const TEXTS = new Set(["text", "password", "number", "search", "email", "url", "tel"]);

export function connectKeys(driving: Driving, stop: () => void): void {
  const held = new Set<string>();
  const hold = () => {
    let [forward, turn] = [0, 0];
    for (const code of held) {
      forward += WAYS[code]?.[0] ?? 0;
      turn += WAYS[code]?.[1] ?? 0;
    }
    if (held.size > 0) driving.hold("keys", { forward: Math.sign(forward), turn: Math.sign(turn) });
    else driving.release("keys");
  };
  addEventListener(
    "keydown",
    (event) => {
      if (event.code === "Escape" || (event.code === "Space" && !isTyping(event.target))) {
        event.preventDefault();
        event.stopPropagation(); // a space stops, also when a button has the focus
        if (!event.repeat) stop();
      } else if (event.code in WAYS && !event.ctrlKey && !event.altKey && !event.metaKey && !isControl(event.target)) {
        event.preventDefault();
        if (event.repeat) return; // one that was released, for example by leaving the window, must be pressed again
        held.add(event.code);
        hold();
      }
    },
    { capture: true },
  );
  addEventListener("keyup", (event) => {
    if (event.code === "Space" && !isTyping(event.target)) event.preventDefault(); // it would press the button
    if (held.delete(event.code)) hold();
  });
  const lose = () => {
    if (held.size === 0) return;
    held.clear();
    hold();
  };
  addEventListener("blur", lose);
  addEventListener("focusin", (event) => isControl(event.target) && lose());
  document.addEventListener("visibilitychange", lose);
}

function isControl(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.matches("input, select, textarea, [contenteditable]");
}

function isTyping(target: EventTarget | null): boolean {
  return target instanceof HTMLTextAreaElement || (target instanceof HTMLInputElement && TEXTS.has(target.type));
}
