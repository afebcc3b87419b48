/** Drawing at the browser's pace: however often something changes, it is drawn once a frame. */

/** A function that draws soon; what it is called for until then is one drawing. */
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
