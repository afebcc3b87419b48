/** Drawing at the browser's frame rate, however often data changes. */

/** Return a function that schedules one drawing for all calls until the next frame. */
export function onceAFrame(draw: () => unknown): () => void {
  let isScheduled = false;
  return () => {
    if (isScheduled) return;
    isScheduled = true;
    requestAnimationFrame(() => {
      isScheduled = false;
      draw();
    });
  };
}
