/**
 * The joystick for fingers and mice, drawn by nipplejs. Every way of losing the pointer releases it.
 *
 * Where its middle is, is measured when it is pressed. A robot that connects or a finding may move it on the screen while
 * it is held: then the same place of the finger means the same velocity, never the opposite one.
 */

import nipplejs from "nipplejs";
import { find } from "./dom";
import type { Deflection, Driving } from "./driving";

const SIZE_PX = 150;
const DEAD_ZONE = 0.08;

const MAIN_BUTTON = 1; // in `buttons`

/** Whether the user sees the stick: its middle is in the window, and nothing but its own texts lies over it. */
export function isStickShown(): boolean {
  const zone = find("#joystick");
  const { left, top, width, height } = zone.getBoundingClientRect();
  if (width === 0) return false;
  const above = document.elementFromPoint(left + width / 2, top + height / 2);
  return above !== null && zone.parentElement?.contains(above) === true;
}

/** Return what shows a command on the knob: keys and gamepads move it too. While the stick is held it follows the pointer. */
export function connectJoystick(zone: HTMLElement, driving: Driving): (command: Deflection) => void {
  const isOther = (event: PointerEvent) => event.pointerType === "mouse" && (event.buttons & MAIN_BUTTON) === 0;
  zone.addEventListener(
    "pointerdown",
    (event) => {
      if (isOther(event)) event.stopImmediatePropagation();
      else if (!zone.classList.contains("held")) joystick.reposition();
    },
    { capture: true },
  );
  zone.addEventListener("contextmenu", (event) => {
    event.preventDefault(); // also for a finger that rests: a menu would end the touch
    event.stopPropagation();
  });
  const joystick = nipplejs.create({
    zone,
    mode: "static",
    position: { left: "50%", top: "50%" },
    size: SIZE_PX,
    color: { front: "var(--accent)", back: "transparent" },
    restOpacity: 1,
    fadeTime: 0,
  });
  const strafe = find<HTMLButtonElement>("#strafe");
  const release = () => {
    zone.classList.remove("held");
    driving.release("joystick");
  };
  joystick.on("move", (event) => {
    const { angle, distance } = event.data;
    const part = Math.min(1, distance / (SIZE_PX / 2));
    zone.classList.add("held");
    const [forward, left] = part < DEAD_ZONE ? [0, 0] : [part * Math.sin(angle.radian), -part * Math.cos(angle.radian)];
    const isSideways = driving.hasSideways && strafe.ariaPressed === "true";
    driving.hold("joystick", isSideways ? { forward, turn: 0, left } : { forward, turn: left });
  });
  joystick.on("end", release);
  addEventListener(
    "pointermove",
    (event) => {
      if (!isOther(event) || !zone.classList.contains("held")) return;
      // it was released where no event was reported
      document.dispatchEvent(new PointerEvent("pointerup", { pointerId: event.pointerId }));
      release();
    },
    { capture: true },
  );
  for (const lost of ["pointercancel", "touchcancel", "touchend"]) zone.addEventListener(lost, release);
  addEventListener("resize", () => driving.releaseAll()); // nipplejs then measures again
  strafe.addEventListener("click", () => {
    if (driving.holds("joystick")) driving.bar("joystick"); // it must be released before it means something else
    strafe.ariaPressed = String(strafe.ariaPressed !== "true");
  });
  const knob = find("#joystick .front");
  return ({ forward, turn, left = 0 }) => {
    const aside = turn + left;
    const radius = SIZE_PX / 2 / Math.max(1, Math.hypot(forward, aside)); // the knob stays within the circle
    const isHeld = zone.classList.contains("held");
    knob.style.translate = isHeld ? "none" : `${-aside * radius}px ${-forward * radius}px`;
  };
}
