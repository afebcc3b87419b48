/** The joystick for fingers and mice: nipplejs draws and follows it; every way of losing it is a release. */

import nipplejs from "nipplejs";
import type { Driving } from "./driving";

const SIZE_PX = 168;
const DEAD_ZONE = 0.08;

export function connectJoystick(zone: HTMLElement, driving: Driving): void {
  const joystick = nipplejs.create({
    zone,
    mode: "static",
    position: { left: "50%", top: "50%" },
    size: SIZE_PX,
    color: { front: "var(--accent)", back: "transparent" },
    restOpacity: 1,
    fadeTime: 0,
  });
  const release = () => {
    zone.classList.remove("held");
    driving.release("joystick");
  };
  joystick.on("move", (event) => {
    const { angle, distance } = event.data;
    const part = Math.min(1, distance / (SIZE_PX / 2));
    zone.classList.add("held");
    if (part < DEAD_ZONE) driving.hold("joystick", { forward: 0, turn: 0 });
    else driving.hold("joystick", { forward: part * Math.sin(angle.radian), turn: -part * Math.cos(angle.radian) });
  });
  joystick.on("end", release);
  for (const lost of ["pointercancel", "touchcancel", "touchend"]) zone.addEventListener(lost, release);
}
