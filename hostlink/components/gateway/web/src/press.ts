/** Buttons that act when they are pressed, not when they are released. */

/**
 * Act on pointer down: sliding off, scrolling, or a second finger prevents a click. `isScrolled`: the button is in a
 * list that fingers scroll, so a finger acts by a tap.
 */
export function onPress(button: HTMLElement, act: () => void, { isScrolled = false } = {}): void {
  let isDone = false; // by the pointer down
  button.addEventListener("pointerdown", ({ pointerType }) => {
    if (isScrolled && pointerType === "touch") return;
    isDone = true;
    act();
  });
  button.addEventListener("click", ({ detail }) => {
    if (detail === 0 || !isDone) act(); // by a key or an assistive tool
    isDone = false;
  });
}
