"use strict";
// The picture of the maps: shadow.glsl, then maps.glsl over what is seen, then present.glsl onto the canvas. While it
// changes it has as many pixels as the machine draws in time; at rest it has all, each a mean of several samples.
const mapPicture = (canvas, gl, scene, textures) => {
  const SAMPLES = 8;           // of a pixel at rest, where it is wider than a texel
  const SLOW = 70, FAST = 34;  // milliseconds between pictures from which they get fewer or more pixels
  const AIM = 50, CHANGE = [0.25, 1.3];  // milliseconds; of the pixels, between two pictures
  const AT_ONCE = 100;         // milliseconds within which a picture follows another while something moves
  const LEAST = 1 << 14, MOST = 1 << 23;  // pixels
  const SHADOWS = 0.25;        // texels of the shadows for a pixel
  const AT_REST = 1 << 20;     // texels of the shadows
  const programs = Object.fromEntries(["shadow", "maps", "present"].map(
    (name) => [name, webgl.program(gl, document.getElementById(`${name}-shader`).textContent)],
  ));
  if (Object.values(programs).includes(null)) return null;
  const lights = webgl.texture(gl, gl.NEAREST), none = webgl.texture(gl, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
  const targets = { shadow: target("RGBA8"), moving: target("RGBA8"), resting: target("RGBA16F") };
  const { camera } = scene, size = scene.layers.find((layer) => layer.name === "geometry").size;
  const parts = scene.layers.filter((layer) => layer.name.startsWith("beyond"));
  let state = null, samples = 0, resting = false, waiting = 0, rest = 0, asked = 0, last = 0;
  let budget = 1 << 19, shadowed = null;

  function target(format) {
    return { frame: gl.createFramebuffer(), format, of: webgl.texture(gl, gl.LINEAR), size: [0, 0] };
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
    const rows = state.emitters, table = new Float32Array(32 * Math.max(rows.length, 1));
    table.set(rows.flat());
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, lights);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 8, Math.max(rows.length, 1), 0, gl.RGBA, gl.FLOAT, table);
  }

  function castShadows(most) {
    const scale = Math.min(1, Math.sqrt(most / (size[0] * size[1])));
    const wide = size.map((side) => Math.max(Math.round(side * scale), 1)), key = JSON.stringify([state.emitters, wide]);
    if (key === shadowed) return;
    shadowed = key;
    const [low, high] = scene.heights, program = programs.shadow;
    begin(targets.shadow, wide);
    use(program, { ...place, size, target_size: wide, texel: camera.texel, low, high }, { count: state.emitters.length });
    const rows = [...camera.to_pixel, [0, 0, 0, 1]].flat();  // a point times it: GLSL takes them for columns
    gl.uniformMatrix4fv(program.place("to_pixel"), false, rows);
    mapTextures.bind(gl, program, { relief: [textures.relief], lights: [lights] });
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

  function shade(into, of, shift, shadows) {
    const { overlay, material } = state, program = programs.maps;
    begin(into, of.size);
    use(program, {
      ...place, size, corner: of.corner.map((x, i) => x + shift[i] * of.stride), stride: [of.stride, of.stride],
      specular: material.specular, coarser: parts[0]?.coarser ?? 1, first_power: scene.first_power,
      gain: state.gain, black: state.black, exposure: state.exposure, opacity: state.opacity,
      towards_right: camera.right, towards_up: camera.up, pick: overlay.pick ?? [0, 0, 0, 0],
      numbers_coarser: overlay.coarser ?? 1, overlay_low: overlay.low ?? 0, overlay_high: overlay.high ?? 1,
      unknown: overlay.unknown ?? 0,
    }, {
      count: state.emitters.length, lobe: scene.lobe, powers: scene.shapes[0]?.length ?? 0, placed: scene.placed,
      parts: material.beyond ? parts.length : 0, with_shadows: shadows, with_diffuse: material.diffuse,
      overlay: overlay.kind, logarithmic: overlay.logarithmic ?? false, local_viewer: camera.local_viewer,
    });
    mapTextures.bind(gl, program, {
      geometry: [textures.geometry], k_d_n_s: [textures.k_d], k_s_status: [textures.k_s], own_region: [textures.own],
      lights: [lights], shapes: [textures.shapes], beyond: [textures.beyond, gl.TEXTURE_2D_ARRAY],
      passing: [shadows ? targets.shadow.of : none], colours: [textures.colours], palette: [textures.palette],
      numbers: [textures[overlay.of ?? "k_d"]],
    });
    if (samples > 0) {  // the mean of those so far
      gl.enable(gl.BLEND);
      gl.blendColor(0, 0, 0, 1 / (samples + 1));
      gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
  }

  function present(from, of) {
    const { view, photograph } = state, [width, height] = of.sides, program = programs.present;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = of.sides;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    use(program, {
      size, corner: of.corner, stride: of.stride, view_corner: view.corner, view_stride: of.wide, height,
      exposure: state.exposure, wipe: photograph ? state.wipe * width : -1,
    });
    mapTextures.bind(gl, program, { picture: [from.of], photograph: [photograph ?? none] });
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
    const into = resting ? targets.resting : targets.moving;
    if (shadows) castShadows(resting ? AT_REST : SHADOWS * budget);
    shade(into, of, samples > 0 ? [halton(samples, 2) - 0.5, halton(samples, 3) - 0.5] : [0, 0], shadows);
    present(into, of);
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
