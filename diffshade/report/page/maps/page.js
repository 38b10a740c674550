"use strict";
// The page of maps: its controls become the state that the picture is drawn from.
(async () => {
  const section = document.getElementById("object"), frame = section.querySelector(".frame"), canvas = section.querySelector("canvas");
  const scene = JSON.parse(document.getElementById("maps-scene").textContent);
  const control = (name) => section.querySelector(`[name="${name}"]`);
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
  const size = scene.layers[0].size;
  section.classList.remove("without-webgl");
  section.classList.add("loading");
  if (!gl?.getExtension("EXT_color_buffer_float") || Math.max(...size) > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
    section.classList.add("without-webgl");
    return;
  }
  const { camera, views } = scene, { dot } = vectors, photographs = new Map();
  const light = {}, { first } = scene;
  let picture = null, photograph = null, before = null;

  // The light

  const inCamera = (toward) => [camera.right, camera.up, camera.backward].map((axis) => dot(axis, toward));
  const ofCamera = ([x, y]) => {
    const z = Math.sqrt(Math.max(1 - x * x - y * y, 0));
    return [0, 1, 2].map((i) => x * camera.right[i] + y * camera.up[i] + z * camera.backward[i]);
  };

  function weights(toward) {  // of the light beyond the model (diffshade.texels.unexplained)
    const of = scene.interpolation;
    if (!of) return [];
    const near = of.toward.map((from) => {
      const d = (Math.sqrt(3) * Math.hypot(...from.map((x, i) => x - toward[i]))) / of.width;
      return (1 + d) * Math.exp(-d);
    });
    return of.given[0].map((_, k) => near.reduce((sum, x, i) => sum + x * of.given[i][k], 0));
  }

  function emitters() {
    const view = views[light.view];
    if (light.toward === view.toward && view.complete) return view.emitters;
    return [[...light.toward, 0, ...view.arriving, ...new Array(9).fill(0), ...weights(light.toward)]];
  }

  function relight(at, view) {  // by hand, or as in a photograph
    if (view === undefined) light.toward = ofCamera(at);
    else [light.view, light.toward] = [view, views[view].toward];
    control("view").value = view === undefined ? "" : String(view);
    for (const dot of section.querySelectorAll(".photograph")) {
      dot.classList.toggle("chosen", Number(dot.dataset.view) === view);
    }
    dome.show(inCamera(light.toward));
    const { azimuth, elevation } = dome.angles();
    for (const [name, value] of [["azimuth", azimuth], ["elevation", elevation]]) control(name).value = value;
    seek(view);
    update();
  }

  async function seek(view) {  // the photograph under this light
    const there = view !== undefined && views[view].photograph;
    control("compare").disabled = !there;
    photograph = null;
    if (!there) return;
    if (!photographs.has(view)) photographs.set(view, await mapTextures.photograph(gl, view));
    if (control("view").value === String(view)) photograph = photographs.get(view);
    update();
  }

  // The state

  function update() {
    if (!picture) return;
    const { azimuth, elevation } = dome.angles(), view = views[light.view];
    const exposure = control("exposure").valueAsNumber, specular = control("specular").valueAsNumber;
    const beyond = section.querySelector('[name="shadows"]:checked').value;
    const overlay = scene.overlays[control("overlay").value] ?? { kind: 0 };
    say("azimuth", `${signed(azimuth, 0)}°`);
    say("elevation", `${elevation.toFixed(0)}°`);
    say("exposure", `${exposure > 0 ? "+" : ""}${signed(exposure, 1)}`);
    say("specular", `×${specular.toFixed(2)}`);
    say("opacity", `${Math.round(100 * control("opacity").valueAsNumber)} %`);
    frame.style.setProperty("--at", `${control("wipe").value}%`);
    for (const legend of section.querySelectorAll("[data-legend]")) {
      legend.hidden = legend.dataset.legend !== control("overlay").value;
    }
    control("opacity").parentElement.hidden = !overlay.kind;
    const diffuse = control("diffuse").checked, compared = control("compare").checked ? photograph : null;
    frame.classList.toggle("compares", Boolean(compared));
    picture.draw({
      emitters: emitters(), gain: view.gain, black: view.black, exposure: 2 ** exposure,
      material: { diffuse, specular, beyond: beyond === "photographed" && diffuse, shadows: beyond === "cast" },
      overlay, opacity: control("opacity").valueAsNumber, view: seen,
      photograph: compared, wipe: control("wipe").valueAsNumber / 100,
    });
  }

  const signed = (x, digits) => x.toFixed(digits).replace("-", "−");

  function say(name, text) {
    control(name).setAttribute("aria-valuetext", text);
    control(name).parentElement.querySelector("output").textContent = text;
  }

  const dome = mapDome(section.querySelector(".dome"), views.map((view) => ({ ...view, place: inCamera(view.toward) })), relight);
  const seen = mapView(frame, canvas, size, {
    changed: () => update(),
    light: {
      begin: () => { before = { at: dome.at, view: control("view").value }; },
      move: ([x, y]) => dome.move([before.at[0] + 2 * x, before.at[1] - 2 * y]),
      cancel: () => (before.view === "" ? dome.move(before.at) : relight(null, Number(before.view))),
    },
    line: {
      shown: () => Boolean(photograph) && control("compare").checked,
      at: () => control("wipe").valueAsNumber / 100,
      move: (x) => { control("wipe").value = 100 * x; update(); },
    },
  });

  const turn = () => {
    const [azimuth, elevation] = ["azimuth", "elevation"].map((name) => (control(name).valueAsNumber * Math.PI) / 180);
    dome.move([Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth)]);
  };
  const RAKING = 10;  // degrees above the horizon
  section.addEventListener("input", ({ target: { name, value } }) => {
    if (name === "azimuth" || name === "elevation") turn();
    else if (name === "view") value === "" ? relight(dome.at) : relight(null, Number(value));
    else update();
  });
  control("raking").addEventListener("click", () => {
    control("elevation").value = RAKING;
    turn();
  });
  control("reset").addEventListener("click", () => {
    HTMLFormElement.prototype.reset.call(section.querySelector("form"));  // its own is hidden by the button of that name
    relight(null, first);
  });

  // The picture

  async function build() {
    picture = null;
    photographs.clear();
    picture = mapPicture(canvas, gl, scene, await mapTextures.load(gl, scene));
    section.classList.remove("loading");
    if (!picture) return section.classList.add("without-webgl");
    relight(null, light.view ?? first);
  }
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", build);
  await build();
})();
