"use strict";
// The hemisphere of lights, seen from the camera: a knob is the light, a dot the light of a photograph.
const mapDome = (svg, lights, moved) => {
  const LOWEST = Math.cos((1 * Math.PI) / 180);  // of the radius: a degree above the horizon
  const knob = svg.querySelector(".knob"), ray = svg.querySelector(".ray");
  let at = [0, 0];

  function show([x, y]) {
    at = [x, y];
    for (const [name, value] of [["cx", x], ["cy", -y]]) knob.setAttribute(name, value);
    for (const [name, value] of [["x2", x], ["y2", -y]]) ray.setAttribute(name, value);
    const { azimuth, elevation } = angles();
    svg.setAttribute("aria-valuenow", elevation.toFixed(0));
    svg.setAttribute("aria-valuetext", `from ${azimuth.toFixed(0)}°, ${elevation.toFixed(0)}° above the horizon`);
  }

  function angles() {
    const elevation = (Math.acos(Math.min(Math.hypot(...at), 1)) * 180) / Math.PI;
    return { azimuth: (Math.atan2(at[1], at[0]) * 180) / Math.PI, elevation };
  }

  function move([x, y]) {
    const r = Math.hypot(x, y), scale = r > LOWEST ? LOWEST / r : 1;
    show([x * scale, y * scale]);
    moved(at);
  }

  function pointed(event) {
    const box = svg.getBoundingClientRect(), side = box.width / 2.2;
    move([(event.clientX - box.left - box.width / 2) / side, -(event.clientY - box.top - box.height / 2) / side]);
  }

  svg.addEventListener("pointerdown", (event) => {
    const dot = event.target.closest(".photograph");
    if (dot) return moved(null, Number(dot.dataset.view));
    svg.setPointerCapture(event.pointerId);
    pointed(event);
  });
  svg.addEventListener("pointermove", (event) => svg.hasPointerCapture(event.pointerId) && pointed(event));
  svg.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.15 : 0.03;
    const by = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
    if (!by) return;
    event.preventDefault();
    move([at[0] + by[0], at[1] + by[1]]);
  });

  lights.forEach(({ place: [x, y, z], name, held_out: heldOut }, i) => {
    if (z < 0) return;
    const dot = document.createElementNS(svg.namespaceURI, "circle"), title = document.createElementNS(svg.namespaceURI, "title");
    const about = { class: heldOut ? "photograph left-out" : "photograph", cx: x, cy: -y, r: 0.035, "data-view": i };
    for (const [key, value] of Object.entries(about)) dot.setAttribute(key, value);
    title.textContent = heldOut ? `${name}, left out of the fit` : name;
    dot.append(title);
    svg.insertBefore(dot, ray);
  });
  return { show, move, angles, get at() { return at; } };
};
