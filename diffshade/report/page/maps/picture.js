"use strict";
// The picture of the maps: shadow.glsl and median.glsl, or beyond.glsl, then maps.glsl where the maps are, onto the
// canvas or, where it is interpolated, averaged or compared, by present.glsl. While it changes, a machine that cannot
// draw ten pictures a second draws fewer pixels; at rest there are all, each a mean of several samples.
const mapPicture = (canvas, gl, scene, textures) => {
  const SAMPLES = 8;           // of a pixel at rest, where it is wider than a texel
  const SLOW = 100, FAST = 60;  // milliseconds between pictures from which they get fewer or more pixels
  const AIM = 80, CHANGE = [0.5, 1.3];  // milliseconds; of the pixels, between two pictures
  const AT_ONCE = 100;         // milliseconds within which a picture follows another while something moves
  const LEAST = 1 << 14, MOST = 1 << 23;  // pixels
  const SHADOWS = 1 / 32;      // texels of the shadows for a pixel, while it changes
  const AT_REST = 1 << 20;     // texels of the shadows
  const programs = new Map();
  const lights = webgl.texture(gl, gl.NEAREST), weights = webgl.texture(gl, gl.NEAREST);
  const none = webgl.texture(gl, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
  const targets = { shadow: target("RGBA8"), passing: target("RGBA8"), beyond: target("RGBA16F"), moving: target("RGBA8"), resting: target("RGBA16F") };
  const { camera } = scene, size = scene.layers.find((layer) => layer.name === "geometry").size;
  const parts = scene.layers.filter((layer) => layer.name.startsWith("beyond"));
  const fixed = { LOBE: scene.lobe, ...highlight(), ...(!scene.own && { OWN: 1 }) };
  if (camera.local_viewer) Object.assign(fixed, { LOCAL_VIEWER: 1, POINTS: 1 });
  let state = null, samples = 0, resting = false, waiting = 0, rest = 0, asked = 0, last = 0;
  let budget = MOST, shadowed = null;
  if (!program("maps", fixed)) return null;

  function target(format) {
    return { frame: gl.createFramebuffer(), format, of: webgl.texture(gl, gl.LINEAR), size: [0, 0] };
  }

  function program(name, defined) {  // with what it needs of the definitions that a picture makes
    const key = JSON.stringify([name, defined]);
    if (!programs.has(key)) programs.set(key, webgl.program(gl, document.getElementById(`${name}-shader`).textContent, defined));
    return programs.get(key);
  }

  function highlight() {  // that texels share: a line that adds its powers, each the square of the one before
    const { shapes, first_power: first, lobe } = scene, doublings = Math.log2(first);
    if (shapes.length !== 1 || !Number.isInteger(doublings) || doublings < 0 || lobe > 1) {
      return shapes.length ? { POWERS: shapes[0].length } : {};
    }
    const add = (weight, j) => (j ? "power *= power;" : "") + (weight ? ` total += ${weight.toExponential()} * power;` : "");
    return { SHAPE: "power *= power; ".repeat(doublings) + shapes[0].map(add).join(" ") };
  }

  function begin(into, [width, height]) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, into.frame);
    if (into.size[0] !== width || into.size[1] !== height) {
      into.size = [width, height];
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, into.of);
      const kind = into.format === "RGBA8" ? gl.UNSIGNED_BYTE : gl.HALF_FLOAT;
      gl.texImage2D(gl.TEXTURE_2D, 0, gl[into.format], width, height, 0, gl.RGBA, kind, null);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, into.of, 0);
    }
    gl.viewport(0, 0, width, height);
  }

  function use(program, numbers, whole = {}) {  // with its uniforms: vectors by their length
    gl.useProgram(program.of);
    for (const [name, value] of Object.entries(numbers)) {
      const place = program.place(name);
      if (typeof value === "number") gl.uniform1f(place, value);
      else gl[`uniform${value.length}fv`](place, value);
    }
    for (const [name, value] of Object.entries(whole)) gl.uniform1i(program.place(name), value);
  }

  const place = Object.fromEntries(
    ["origin", "direction"].flatMap((name) => ["", "_column", "_row"].map((by) => [name + by, camera[name + by]])),
  );
  Object.assign(place, { eye: camera.eye, backward: camera.backward });

  function upload() {
    const rows = state.emitters.map((row) => row.slice(0, 16)), number = Math.max(rows.length, 1);
    fill(lights, gl.RGBA32F, gl.RGBA, [4, number], rows);
    fill(weights, gl.R32F, gl.RED, [Math.max(parts.length, 1), number], state.emitters.map((row) => row.slice(16, 16 + parts.length)));
  }

  function fill(texture, format, channels, [width, height], rows) {
    const table = new Float32Array(width * height * (channels === gl.RED ? 1 : 4));
    table.set(rows.flat());
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, width, height, 0, channels, gl.FLOAT, table);
  }

  function lighting() {  // what a program needs of the light: DISTANT, one at infinity, or points that it is seen from
    if (state.emitters.length === 1 && state.emitters[0][3] === 0) return { DISTANT: 1 };
    return scene.placed ? { POINTS: 1 } : {};
  }

  function shine(program, { DISTANT }) {
    gl.uniform1i(program.place("count"), state.emitters.length);
    if (!DISTANT) return;
    gl.uniform3fv(program.place("toward"), state.emitters[0].slice(0, 3));
    gl.uniform3fv(program.place("intensity"), state.emitters[0].slice(4, 7));
  }

  function castShadows(most) {
    const scale = Math.min(1, Math.sqrt(most / (size[0] * size[1])));
    const wide = size.map((side) => Math.max(Math.round(side * scale), 1)), key = JSON.stringify([state.emitters, wide, resting]);
    if (key === shadowed) return;
    shadowed = key;
    const [low, high] = scene.heights, defined = lighting(), shadow = program("shadow", defined);
    begin(targets.shadow, wide);
    use(shadow, { ...place, size, target_size: wide, texel: camera.texel, low, high, growth: resting ? 0.03 : 0.1 });
    shine(shadow, defined);
    const rows = [...camera.to_pixel, [0, 0, 0, 1]].flat();  // a point times it: GLSL takes them for columns
    gl.uniformMatrix4fv(shadow.place("to_pixel"), false, rows);
    mapTextures.bind(gl, shadow, { relief: [textures.relief], lights: [lights] });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const median = program("median", {});
    begin(targets.passing, wide);
    use(median, { target_size: wide, apart: 1.5 * scale });
    mapTextures.bind(gl, median, { shadow: [targets.shadow.of] });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function goBeyond() {
    const defined = { PARTS: parts.length, ...lighting() };
    if (defined.DISTANT) defined.SUM = parts.map((_, k) => `total += weight[${k}] * part(at, ${k});`).join(" ");
    const beyond = program("beyond", defined);
    begin(targets.beyond, parts[0].size);
    use(beyond, { ...place, coarser: parts[0].coarser, gain: state.gain });
    shine(beyond, defined);
    if (defined.SUM) gl.uniform1fv(beyond.place("weight"), state.emitters[0].slice(16, 16 + parts.length));
    mapTextures.bind(gl, beyond, {
      geometry: [textures.geometry], lights: [lights], weights: [weights], parts: [textures.beyond, gl.TEXTURE_2D_ARRAY],
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function frame_() {  // of the canvas, and of the picture: where it begins, how wide its pixels are, how many
    const { corner, stride, pixels } = state.view;
    const few = resting ? 1 : Math.max(1, Math.sqrt((pixels[0] * pixels[1]) / budget));
    const sides = pixels.map((side) => Math.max(Math.round(side / few), 1)), wide = (stride * pixels[0]) / sides[0];
    const of = { corner, stride: wide, size: sides, sides, wide };
    if (wide > 1) return of;
    of.corner = corner.map((x, i) => Math.min(Math.max(Math.floor(x) - 1, 0), size[i] - 1));  // each texel once
    of.size = sides.map((side, i) => {
      return Math.max(Math.min(Math.ceil(corner[i] + side * wide) + 1, size[i]) - of.corner[i], 1);
    });
    of.stride = 1;
    return of;
  }

  function shade(into, of, { shift = [0, 0], shadows, beyond }) {  // into a target, or onto the canvas
    const { overlay, material } = state, height = of.size[1];
    const defined = {
      ...fixed, ...lighting(),
      ...(shadows && { SHADOWS: 1 }), ...(beyond && { BEYOND: 1 }), ...(overlay.kind && { OVERLAY: overlay.kind }),
    };
    const maps = program("maps", defined), first = of.corner.map((x, i) => x + shift[i] * of.stride);
    if (into) begin(into, of.size);
    else beginCanvas(of);
    if (samples === 0) gl.clear(gl.COLOR_BUFFER_BIT);
    use(maps, {
      ...place, size, corner: into ? first : [first[0], first[1] + height * of.stride],
      stride: [of.stride, into ? of.stride : -of.stride],
      diffuse: Number(material.diffuse), specular: material.specular, coarser: parts[0]?.coarser ?? 1,
      own: scene.own ?? [0, 0, 0], first_power: scene.first_power,
      gain: state.gain, black: state.black, exposure: state.exposure, opacity: state.opacity,
      towards_right: camera.right, towards_up: camera.up, pick: overlay.pick ?? [0, 0, 0, 0],
      numbers_coarser: overlay.coarser ?? 1, overlay_low: overlay.low ?? 0, overlay_high: overlay.high ?? 1,
      unknown: overlay.unknown ?? 0,
    }, { logarithmic: overlay.logarithmic ?? false });
    shine(maps, defined);
    mapTextures.bind(gl, maps, {
      geometry: [textures.geometry], k_d_n_s: [textures.k_d], k_s_status: [textures.k_s], own_region: [textures.own],
      lights: [lights], shapes: [textures.shapes], beyond: [beyond ? targets.beyond.of : none],
      passing: [shadows ? targets.passing.of : none], colours: [textures.colours], palette: [textures.palette],
      numbers: [textures[overlay.of ?? "k_d"]],
    });
    if (samples > 0) {  // the mean of those so far
      gl.enable(gl.BLEND);
      gl.blendColor(0, 0, 0, 1 / (samples + 1));
      gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    }
    const ends = size.map((side, i) => [0, side].map((x) => Math.round((x - first[i]) / of.stride)));
    const [[left, right], [top, bottom]] = ends.map((end) => [end[0] - 1, end[1] + 1]);  // of the maps, in the picture
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(left, into ? top : height - bottom, Math.max(right - left, 0), Math.max(bottom - top, 0));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
  }

  function beginCanvas(of) {
    const [width, height] = of.sides;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = of.sides;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
  }

  function present(from, of) {
    const { view, photograph } = state, [width, height] = of.sides, shown = program("present", photograph ? { COMPARED: 1 } : {});
    beginCanvas(of);
    use(shown, {
      size, corner: of.corner, stride: of.stride, view_corner: view.corner, view_stride: of.wide, height,
      exposure: state.exposure, wipe: photograph ? state.wipe * width : -1,
    });
    mapTextures.bind(gl, shown, { picture: [from.of], photograph: [photograph ?? none] });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function frame(now) {
    waiting = 0;
    if (gl.isContextLost() || !state) return;
    if (!resting) {
      const took = now - last;
      if (asked - last < AT_ONCE && (took > SLOW || took < FAST)) {
        const change = Math.min(Math.max(AIM / took, CHANGE[0]), CHANGE[1]);
        budget = Math.min(Math.max(budget * change, LEAST), MOST);
      }
      last = now;
      upload();
    }
    const of = frame_(), shadows = state.material.shadows && Boolean(scene.heights);
    const beyond = state.material.beyond && parts.length > 0;
    if (shadows) castShadows(resting ? AT_REST : SHADOWS * Math.min(budget, of.sides[0] * of.sides[1]));
    if (beyond && samples === 0) goBeyond();
    if (!resting && of.wide > 1 && !state.photograph) shade(null, of, { shadows, beyond });
    else {
      const into = resting ? targets.resting : targets.moving;
      shade(into, of, { shadows, beyond, ...(samples > 0 && { shift: [halton(samples, 2) - 0.5, halton(samples, 3) - 0.5] }) });
      present(into, of);
    }
    if (resting) samples += 1;
    const done = resting && samples >= (of.wide > 1 ? SAMPLES : 1);
    canvas.dataset.resting = String(done);
    if (!done) rest = setTimeout(refine, resting ? 0 : 160);
  }

  function refine() {
    resting = true;
    ask();
  }

  function ask() {
    if (waiting) return;
    asked = performance.now();
    waiting = requestAnimationFrame(frame);
  }

  function halton(i, base) {
    let found = 0, share = 1;
    for (let left = i; left > 0; left = Math.floor(left / base)) {
      share /= base;
      found += share * (left % base);
    }
    return found;
  }

  return {
    draw(next) {  // another picture
      state = next;
      samples = 0;
      resting = false;
      canvas.dataset.resting = "false";
      clearTimeout(rest);
      ask();
    },
  };
};
