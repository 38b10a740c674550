"use strict";
// What of the maps is seen: zooming and moving by wheel, pointer, pinch, keys and buttons; and dragging the light.
const mapView = (frame, canvas, size, { changed, light, line }) => {
  const MOST = 32;  // pixels of the canvas that a texel may be wide
  const density = () => window.devicePixelRatio || 1;
  const pointers = new Map();
  let corner = [0, 0], stride = 1, whole = true, dragging = null, from = null, seen = pixels();

  function pixels() {
    return [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(Math.round(side * density()), 1));
  }

  function fit() {  // all of it, in the middle
    const [width, height] = pixels();
    stride = Math.max(size[0] / width, size[1] / height);
    corner = [(size[0] - width * stride) / 2, (size[1] - height * stride) / 2];
    whole = true;
  }

  function resize() {  // the middle of what is seen stays there
    const now = pixels();
    if (now.every((side, i) => side === seen[i])) return;
    corner = corner.map((x, i) => x + ((seen[i] - now[i]) * stride) / 2);
    seen = now;
    if (whole) fit();
    changed();
  }

  function zoom(factor, at = pixels().map((side) => side / 2)) {  // about a pixel of the canvas
    const [width, height] = pixels(), widest = Math.max(size[0] / width, size[1] / height);
    const next = Math.min(Math.max(stride / factor, 1 / MOST), 2 * widest);
    corner = corner.map((x, i) => x + at[i] * (stride - next));
    [stride, whole] = [next, false];
    move([0, 0]);
  }

  function move(by) {  // pixels of the canvas; its middle stays on the maps
    corner = corner.map((x, i) => {
      const half = (pixels()[i] * stride) / 2;
      return Math.min(Math.max(x - by[i] * stride, -half), size[i] - half);
    });
    if (by[0] || by[1]) whole = false;
    changed();
  }

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * density(), (event.clientY - box.top) * density()];
  };
  const middle = () => [0, 1].map((i) => [...pointers.values()].reduce((sum, at) => sum + at[i], 0) / pointers.size);
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, place(event));
    const [x] = place(event), moves = event.button > 0 || event.shiftKey;
    const onLine = line.shown() && Math.abs(x - line.at() * pixels()[0]) < 12 * density();
    dragging = pointers.size > 1 || moves ? "picture" : onLine ? "line" : "light";
    if (dragging !== "light") return;
    from = place(event);
    light.begin();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = middle(), apart = pointers.size > 1 ? spread() : 0;
    pointers.set(event.pointerId, place(event));
    const after = middle(), by = after.map((x, i) => x - before[i]);
    if (dragging === "light") light.move(after.map((x, i) => (x - from[i]) / Math.min(...pixels())));
    else if (dragging === "line") line.move(after[0] / pixels()[0]);
    else {
      move(by);
      if (apart) zoom(spread() / apart, after);
    }
  });
  canvas.addEventListener("pointerup", (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("pointercancel", (event) => {  // the page scrolls
    if (pointers.delete(event.pointerId) && dragging === "light") light.cancel();
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey && !document.fullscreenElement) return;  // the page scrolls
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / (event.deltaMode ? 12 : 400)), place(event));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = 40 * density(), pan = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (event.key === "+" || event.key === "=") zoom(1.25);
    else if (event.key === "-") zoom(0.8);
    else if (event.key === "0") { fit(); changed(); }
    else if (event.key in pan) move(pan[event.key]);
    else return;
    event.preventDefault();
  });
  const actions = {
    closer: () => zoom(1.5),
    farther: () => zoom(1 / 1.5),
    whole: () => { fit(); changed(); },
    exact: () => zoom(stride),  // a texel a pixel
    fullscreen: () => (document.fullscreenElement ? document.exitFullscreen() : frame.requestFullscreen()),
  };
  for (const [name, act] of Object.entries(actions)) frame.querySelector(`[name="${name}"]`).addEventListener("click", act);
  new ResizeObserver(resize).observe(canvas);
  fit();
  return {
    get corner() { return corner; },
    get stride() { return stride; },
    get pixels() { return pixels(); },
  };
};
