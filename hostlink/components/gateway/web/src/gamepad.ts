/**
 * A gamepad drives with its left stick while a shoulder button is held, where the page's stick is visible. Its right
 * stick moves the robot sideways. Losing the gamepad releases the stick. A button that was held without the focus, or
 * while the stick was not visible, must be released first.
 */

import { setText } from "./dom";
import type { Driving } from "./driving";
import { isStickShown } from "./joystick";
import { keepNotice } from "./notice";

const POLL_MS = 16; // the rate at which browsers read it; a short press of the stop must not be missed
const SHOULDERS = [4, 5]; // of the standard mapping; one of them must be held
const STOP_BUTTON = 1; // B, or the circle
const DEAD_ZONE = 0.12;
const HIDDEN = "The gamepad drives only where the stick is visible.";
const HIDDEN_MS = 3000;

export function connectGamepad(note: HTMLElement, driving: Driving, stop: () => void): void {
  if (!("getGamepads" in navigator)) {
    setText(note, "Gamepad: this browser allows it only over https or on localhost.");
    return;
  }
  let isStopping = false;
  const poll = () => {
    const pads = navigator.getGamepads().filter((each) => each?.connected && each.axes.length >= 2);
    const isHere = document.hasFocus(); // browsers report it to every window, and each would drive
    // other devices may be listed as gamepads: the one whose shoulder button is held drives
    const pad = pads.find(isEnabledBy) ?? pads[0] ?? null;
    const isEnabled = isEnabledBy(pad);
    if (pad !== null && isEnabled && isHere && isStickShown()) {
      const [turn = 0, forward = 0, left = 0] = pad.axes.map((axis) => bend(-axis));
      driving.hold("gamepad", { forward, turn, left: pad.mapping === "standard" ? left : 0 }); // else a trigger
    } else if (isEnabled) {
      driving.bar("gamepad");
      if (isHere) keepNotice("done", HIDDEN, HIDDEN_MS);
    } else {
      driving.release("gamepad");
    }
    const wantsStop = pads.some((each) => each?.buttons[STOP_BUTTON]?.pressed);
    if (wantsStop && !isStopping) stop();
    isStopping = wantsStop;
    setText(note, describe(pad, isHere, isEnabled, driving.holds("gamepad")));
  };
  setInterval(poll, POLL_MS);
}

function isEnabledBy(pad: Gamepad | null): boolean {
  return SHOULDERS.some((button) => pad?.buttons[button]?.pressed);
}

function describe(pad: Gamepad | null, isHere: boolean, isEnabled: boolean, isDriving: boolean): string {
  if (pad === null) return "Gamepad: none found. Press a button on it.";
  if (!isHere) return "Gamepad: another window has the focus. The stop button works.";
  if (isDriving) return "Gamepad: driving";
  if (isEnabled) return "Gamepad: release the shoulder button, and hold it again to drive";
  return "Gamepad: hold a shoulder button (LB, RB) to drive";
}

function bend(axis: number): number {
  return Math.abs(axis) < DEAD_ZONE ? 0 : axis;
}
