// Measures the page as it stands: what leaves the window, what lies over something else, what is hard to read.
() => {
  const found = [];
  const name = (element) => {
    const id = element.id ? `#${element.id}` : "";
    const classes = typeof element.className === "string" && element.className ? `.${element.className.trim().split(/\s+/).join(".")}` : "";
    const within = element.closest("[id]");
    const text = (element.textContent || "").trim().slice(0, 24);
    return `${within && within !== element ? `#${within.id} ` : ""}${element.tagName.toLowerCase()}${id}${classes} "${text}"`;
  };
  const scrolls = (style, axis) => ["auto", "scroll"].includes(style[`overflow${axis}`]);
  // The part of an element that its scrolling or clipping ancestors show; null: nothing of it.
  const visible = (element, rect) => {
    let { left, top, right, bottom } = rect;
    for (let at = element.parentElement; at && at !== document.body; at = at.parentElement) {
      const style = getComputedStyle(at);
      if (style.overflowX === "visible" && style.overflowY === "visible") continue;
      const box = at.getBoundingClientRect();
      left = Math.max(left, box.left);
      right = Math.min(right, box.right);
      top = Math.max(top, box.top);
      bottom = Math.min(bottom, box.bottom);
    }
    return right - left > 1 && bottom - top > 1 ? { left, top, right, bottom } : null;
  };
  const isCut = (element) => {
    for (let at = element.parentElement; at && at !== document.body; at = at.parentElement) {
      const style = getComputedStyle(at);
      if (scrolls(style, "X") || style.clipPath !== "none") return true;
    }
    return getComputedStyle(element).clipPath !== "none";
  };

  // every element stays within the window
  for (const element of document.querySelectorAll("body *")) {
    if (!element.checkVisibility({ visibilityProperty: true }) || element.closest("svg, #panel-menu")) continue;
    const rect = element.getBoundingClientRect();
    if (rect.width === 0 || rect.height === 0) continue;
    const style = getComputedStyle(element);
    if ((rect.left < -0.5 || rect.right > innerWidth + 0.5) && !isCut(element)) {
      found.push(`leaves the window: ${name(element)} ${Math.round(rect.left)}..${Math.round(rect.right)} of ${innerWidth}`);
    }
    const isFrame = !element.closest("main");
    if (isFrame && (rect.top < -0.5 || rect.bottom > innerHeight + 0.5)) found.push(`is below the window: ${name(element)}`);
    const mayCut = style.textOverflow === "ellipsis" || style.webkitLineClamp !== "none" || style.clipPath !== "none";
    if (style.overflowX === "hidden" && element.scrollWidth > element.clientWidth + 1 && !mayCut && !element.matches(".floor, canvas, .u-wrap *, .u-over")) {
      found.push(`is cut: ${name(element)} ${element.scrollWidth} of ${element.clientWidth}`);
    }
    const isDrawn = element.matches(".floor, canvas, .u-wrap *, .u-over, #joystick *");
    if (style.overflowY === "hidden" && element.scrollHeight > element.clientHeight + 2 && !mayCut && !isDrawn) {
      found.push(`is cut below: ${name(element)} ${element.scrollHeight} of ${element.clientHeight}`);
    }
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push(`scrolls sideways: ${document.documentElement.scrollWidth}`);
  if (document.documentElement.scrollHeight > innerHeight) found.push(`scrolls as a whole: ${document.documentElement.scrollHeight}`);

  // no atom lies over another: texts, controls, pictures
  const atoms = [];
  const add = (element, rect, what) => {
    const shown = visible(element, rect);
    if (shown !== null) atoms.push({ element, ...shown, what });
  };
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const leaves = [];
  for (let node = texts.nextNode(); node; node = texts.nextNode()) {
    const element = node.parentElement;
    if (!node.data.trim() || !element.checkVisibility({ visibilityProperty: true })) continue;
    if (element.closest("svg, script, style, #panel-menu") || getComputedStyle(element).clipPath !== "none") continue;
    leaves.push(element);
    if (element.closest("button")) continue; // the button is the atom
    const range = document.createRange();
    range.selectNodeContents(node);
    const own = element.getBoundingClientRect();
    const isClipped = getComputedStyle(element).overflowX === "hidden";
    for (const rect of range.getClientRects()) {
      const box = isClipped
        ? { left: Math.max(rect.left, own.left), right: Math.min(rect.right, own.right), top: Math.max(rect.top, own.top), bottom: Math.min(rect.bottom, own.bottom) }
        : rect;
      add(element, box, "text");
    }
  }
  for (const element of document.querySelectorAll("button, input:not([type=radio]), canvas, #joystick")) {
    if (element.checkVisibility({ visibilityProperty: true }) && !element.closest("#panel-menu")) {
      add(element, element.getBoundingClientRect(), "control");
    }
  }
  const mayCover = (one, other) => {
    if (one.element.contains(other.element) || other.element.contains(one.element)) return true;
    const over = [".over", ".group", ".cover", "#strafe", "#take-over"]; // what lies over a picture or the stick on purpose
    const isOver = ({ element }) => over.some((each) => element.closest(each));
    const isGround = ({ element }) => element.matches("canvas, #joystick") || element.closest("#joystick, #plots");
    return (isOver(one) && isGround(other)) || (isOver(other) && isGround(one));
  };
  for (let first = 0; first < atoms.length; first++) {
    const one = atoms[first];
    for (let second = first + 1; second < atoms.length; second++) {
      const other = atoms[second];
      const width = Math.min(one.right, other.right) - Math.max(one.left, other.left);
      const height = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
      const isText = one.what === "text" && other.what === "text"; // lines of text stand close
      if (width > 1 && height > (isText ? 4 : 1) && !mayCover(one, other)) {
        found.push(`overlap by ${Math.round(width)}x${Math.round(height)}: ${name(one.element)} and ${name(other.element)}`);
      }
    }
  }

  // what one drives with is there without scrolling
  if (document.body.dataset.layout === "Drive") {
    const main = document.querySelector("main").getBoundingClientRect();
    const needed = ["#stop", "#stop-all:not([hidden])", "#robots .robot:has(:checked)", "#joystick", "#map-canvas", "#link .tiles", "#status"];
    const isWaiting = document.querySelector("#robots .empty").checkVisibility();
    for (const selector of needed) {
      const element = document.querySelector(selector);
      const isStickless = isWaiting && !element?.checkVisibility(); // on a phone, what to do without a robot has the place
      if (element === null || isStickless) continue;
      const rect = element.getBoundingClientRect();
      const shown = visible(element, rect);
      const isWhole = shown && shown.bottom - shown.top > rect.height - 2 && shown.right - shown.left > Math.min(rect.width, innerWidth) - 8;
      if (!isWhole || rect.bottom > innerHeight + 0.5 || rect.height < 20) {
        found.push(`is not in the first view: ${selector} ${Math.round(rect.top)}..${Math.round(rect.bottom)} of ${main.bottom}`);
      }
    }
    const map = document.querySelector("#map-canvas").getBoundingClientRect();
    if (!isWaiting && (map.width < 150 || map.height < 90)) found.push(`the map is small: ${map.width}x${map.height}`);
  }

  // contrast AA
  const ink = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const known = new Map();
  const rgba = (colour) => {
    if (!known.has(colour)) {
      ink.clearRect(0, 0, 1, 1);
      ink.fillStyle = colour;
      ink.fillRect(0, 0, 1, 1);
      const [r, g, b, a] = ink.getImageData(0, 0, 1, 1).data;
      known.set(colour, [r, g, b, a / 255]);
    }
    return known.get(colour);
  };
  const over = ([r, g, b, a], [r2, g2, b2]) => [r * a + r2 * (1 - a), g * a + g2 * (1 - a), b * a + b2 * (1 - a), 1];
  const ground = (element) => {
    const layers = [];
    for (let at = element; at; at = at.parentElement) {
      const colour = rgba(getComputedStyle(at).backgroundColor);
      if (colour[3] > 0) layers.push(colour);
      if (colour[3] >= 0.999) break;
    }
    return layers.reduceRight((below, layer) => over(layer, below), [255, 255, 255, 1]);
  };
  const light = ([r, g, b]) => {
    const part = (value) => (value /= 255) <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
    return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
  };
  for (const element of new Set(leaves)) {
    if (element.closest(":disabled")) continue;
    const style = getComputedStyle(element);
    let opacity = 1;
    for (let at = element; at; at = at.parentElement) opacity *= Number(getComputedStyle(at).opacity);
    const below = ground(element);
    const [r, g, b, a] = rgba(style.color);
    const colour = over([r, g, b, a * opacity], below);
    const [high, low] = [light(colour), light(below)].sort((one, other) => other - one);
    const ratio = (high + 0.05) / (low + 0.05);
    const size = parseFloat(style.fontSize);
    const isLarge = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if (ratio < (isLarge ? 3 : 4.5)) found.push(`contrast ${ratio.toFixed(2)}: ${name(element)}`);
  }
  return [...new Set(found)];
}
