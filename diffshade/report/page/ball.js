"use strict";
// The live ball: the fitted material on a sphere, drawn by ball.glsl, whose numbers come from the page's sliders.
(() => {
  const section = document.getElementById("ball");
  const scene = JSON.parse(document.getElementById("ball-scene").textContent);
  const canvas = section.querySelector("canvas");
  const gl = canvas.getContext("webgl2", {
    alpha: false, antialias: false, depth: false, stencil: false, preserveDrawingBuffer: true,
  });
  if (!gl) {
    section.classList.add("without-webgl");
    return;
  }
  const control = (name) => section.querySelector(`[name="${name}"]`);
  const COLOURS = ["k_a", "k_d", "k_s", "k_e"].filter(control);
  const state = { material: null, base: null };
  let program, texture;

  const { add, dot, turned } = vectors;

  // Drawing

  function build() {
    program = webgl.program(gl, document.getElementById("ball-shader").textContent);
    if (!program) {
      section.classList.add("without-webgl");
      return;
    }
    gl.useProgram(program.of);
    texture = webgl.texture(gl, gl.NEAREST);
  }

  function draw() {
    if (gl.isContextLost() || section.classList.contains("without-webgl")) return;
    const view = scene.views[control("view").value], object = scene.objects[control("object").value];
    const camera = view.cameras[control("object").value];
    if (canvas.width !== camera.width || canvas.height !== camera.height) {
      [canvas.width, canvas.height] = [camera.width, camera.height];
    }
    gl.viewport(0, 0, canvas.width, canvas.height);
    const eye = add(camera.eye, object.center, -1), depth = dot(eye, camera.backward);
    const vectors = {
      // from the plane through the centre on, which float32 holds to the last digit however far the camera is
      origin: add(add(camera.origin, object.center, -1), camera.direction, depth),
      origin_column: add(camera.origin_column, camera.direction_column, depth),
      origin_row: add(camera.origin_row, camera.direction_row, depth),
      direction: camera.direction, direction_column: camera.direction_column, direction_row: camera.direction_row,
      eye, backward: camera.backward, ambient: scene.ambient, background: scene.background,
      ...state.material,
    };
    const numbers = { radius: object.radius, height: camera.height, gain: view.gain, black: view.black, eta: object.eta };
    const whole = {
      local_viewer: camera.local_viewer ? 1 : 0, fresnel: object.fresnel, lights: 0,
      lobe: Number(section.querySelector('[name="lobe"]:checked').value),
      count: upload(view, camera, object),
    };
    for (const [name, value] of Object.entries(vectors)) gl.uniform3fv(program.place(name), value);
    for (const [name, value] of Object.entries(numbers)) gl.uniform1f(program.place(name), value);
    for (const [name, value] of Object.entries(whole)) gl.uniform1i(program.place(name), value);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function upload(view, camera, object) {  // the lights that are on, turned about the centre as the sliders say
    const [turn, tilt] = ["turn", "tilt"].map((name) => (control(name).valueAsNumber * Math.PI) / 180);
    const about = (a) => turned(turned(a, camera.up, turn), camera.right, tilt);
    const rows = view.lit.flatMap((i) => scene.lights[i]).map((emitter) => {
      const [x, y, z, local, ...rest] = emitter, from = local ? object.center : [0, 0, 0];
      const axis = about(rest.slice(4, 7));
      return [...about(add([x, y, z], from, -1)), local, ...rest.slice(0, 4), ...axis, ...rest.slice(7)];
    });
    const table = new Float32Array(rows.length ? rows.flat() : 16);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 4, Math.max(rows.length, 1), 0, gl.RGBA, gl.FLOAT, table);
    return rows.length;
  }

  // Sliders

  function read() {  // a slider is a colour's largest channel; the others keep their shares
    const material = { ...state.base };
    for (const name of COLOURS) {
      const largest = Math.max(...state.base[name]), value = control(name).valueAsNumber;
      material[name] = largest > 0 ? state.base[name].map((x) => (x / largest) * value) : [value, value, value];
      show(name, value.toFixed(3));
    }
    const largest = Math.max(...state.base.n_s), n_s = Math.pow(10, control("n_s").valueAsNumber);
    material.n_s = state.base.n_s.map((x) => (largest > 0 ? (x / largest) * n_s : n_s));
    show("n_s", n_s < 10 ? n_s.toFixed(2) : n_s.toFixed(n_s < 100 ? 1 : 0));
    for (const name of ["turn", "tilt"]) show(name, `${control(name).valueAsNumber.toFixed(0)}°`);
    state.material = material;
    say();
    draw();
  }

  function show(name, text) {
    control(name).setAttribute("aria-valuetext", text);
    control(name).parentElement.querySelector("output").textContent = text;
  }

  function say() {
    const short = (x) => String(Number(x.toPrecision(4)));
    const said = (values) =>
      values.every((x) => x === values[0]) ? short(values[0]) : `(${values.map(short).join(", ")})`;
    const object = scene.objects[control("object").value];
    const shown = [...COLOURS, "n_s"].map((name) => `${name}=${said(state.material[name])}`);
    const lobe = section.querySelector('[name="lobe"]:checked');
    shown.push(`lobe=${lobe.value < 2 ? "ds." : ""}${lobe.dataset.name}${lobe.value < 2 ? "()" : "(...)"}`);
    if (object.fresnel) shown.push(object.fresnel === 1 ? "fresnel=ds.Schlick()" : "fresnel=ds.Dielectric()");
    if (object.fresnel === 2) shown.push(`eta=${short(object.eta)}`);
    section.querySelector(".as-code").textContent = `ds.Material(${shown.join(", ")})`;
  }

  function reset() {
    const object = scene.objects[control("object").value];
    state.base = object.material;
    for (const name of COLOURS) {
      const largest = Math.max(...object.material[name]);
      control(name).max = Math.max(1, 2 * largest);
      control(name).value = largest;
      control(name).disabled = name === "k_s" && object.fresnel === 2;
    }
    const n_s = Math.max(...object.material.n_s, 1e-3);
    control("n_s").min = Math.min(0, Math.log10(n_s));
    control("n_s").max = Math.max(3, Math.log10(2 * n_s));
    control("n_s").value = Math.log10(n_s);
    section.querySelector(`[name="lobe"][value="${object.lobe}"]`).checked = true;
    for (const name of ["turn", "tilt"]) control(name).value = 0;
    read();
  }

  // Dragging

  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    held = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    const by = [event.clientX - held[0], event.clientY - held[1]];
    held = [event.clientX, event.clientY];
    ["turn", "tilt"].forEach((name, i) => {
      const angle = control(name).valueAsNumber + (by[i] * 180) / canvas.clientWidth;
      control(name).value = ((angle + 540) % 360) - 180;
    });
    read();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (held = null));

  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { build(); draw(); });
  section.addEventListener("input", (event) => (event.target.name === "object" ? reset() : read()));
  control("reset").addEventListener("click", reset);
  build();
  reset();
})();
