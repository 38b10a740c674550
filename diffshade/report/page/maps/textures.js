"use strict";
// The maps as textures: files of integers, made numbers once by decode.glsl.
const mapTextures = (() => {
  const source = (id) => document.getElementById(id)?.textContent;

  async function picture(id, kind = "webp") {
    const image = new Image();
    image.src = `data:image/${kind};base64,${source(id)}`;
    await image.decode();
    return image;
  }

  async function bytes(gl, id, filter = gl.NEAREST) {
    const image = await picture(id), of = webgl.texture(gl, filter);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    return of;
  }

  async function planes(gl, layer) {  // its low bytes, and its high ones where it has some
    const low = await bytes(gl, `${layer.name}-0`);
    return { ...layer, low_bytes: low, high_bytes: layer.planes > 1 ? await bytes(gl, `${layer.name}-1`) : low };
  }

  function bind(gl, program, samplers) {
    Object.entries(samplers).forEach(([name, [of, target = gl.TEXTURE_2D]], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, of);
      gl.uniform1i(program.place(name), unit);
    });
    gl.activeTexture(gl.TEXTURE0);
  }

  function tell(gl, program, name, layer) {
    for (const of of ["steps", "low", "high"]) gl.uniform3fv(program.place(`${name}.${of}`), layer[of]);
    gl.uniform3iv(program.place(`${name}.curve`), layer.curve);
    gl.uniform1f(program.place(`${name}.bytes`), layer.planes);
  }

  function fill(gl, attach, [width, height], program, samplers) {  // let a program draw what is attached
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    attach();
    gl.viewport(0, 0, width, height);
    bind(gl, program, samplers);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.deleteFramebuffer(frame);
  }

  function filled(gl, format, size, program, samplers, levels = 1) {  // a texture that a program draws
    const of = webgl.texture(gl, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, levels, format, ...size);
    const attach = () => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, of, 0);
    fill(gl, attach, size, program, samplers);
    return of;
  }

  async function load(gl, scene) {
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    const layers = Object.fromEntries(scene.layers.map((layer) => [layer.name, layer]));
    const found = {}, size = layers.geometry.size, index = await planes(gl, layers.index);
    const decode = webgl.program(gl, source("decode-shader"));
    gl.useProgram(decode.of);
    tell(gl, decode, "index_layer", index);
    const numbers = async (name, beside, draw) => {  // of a layer, with a channel of the index beside them
      const layer = await planes(gl, layers[name]);
      gl.useProgram(decode.of);
      tell(gl, decode, "layer", layer);
      gl.uniform1i(decode.place("beside"), beside);
      gl.uniform1i(decode.place("geometry"), name === "geometry");
      const found = draw({
        low_bytes: [layer.low_bytes], high_bytes: [layer.high_bytes],
        index_low_bytes: [index.low_bytes], index_high_bytes: [index.high_bytes],
      });
      for (const of of new Set([layer.low_bytes, layer.high_bytes])) gl.deleteTexture(of);
      return found;
    };
    for (const [name, beside, format] of [
      ["geometry", 0, gl.RGBA32F], ["k_d", 0, gl.RGBA16F], ["k_s", 1, gl.RGBA16F], ["own", 2, gl.RGBA16F],
    ]) {
      found[name] = await numbers(name, beside, (samplers) => filled(gl, format, size, decode, samplers));
    }
    const parts = scene.layers.filter((layer) => layer.name.startsWith("beyond")), wide = parts[0]?.size ?? [1, 1];
    found.beyond = webgl.texture(gl, parts[0]?.coarser > 1 ? gl.LINEAR : gl.NEAREST, gl.TEXTURE_2D_ARRAY);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA16F, ...wide, Math.max(parts.length, 1));
    for (const [k, { name }] of parts.entries()) {
      const attach = () => gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, found.beyond, 0, k);
      await numbers(name, 0, (samplers) => fill(gl, attach, wide, decode, samplers));
    }
    for (const of of new Set([index.low_bytes, index.high_bytes])) gl.deleteTexture(of);
    if (scene.heights) found.relief = relief(gl, scene, found, size);
    for (const name of ["errors0", "errors1"]) found[name] = await bytes(gl, `${name}-0`);
    found.palette = table(gl, scene.status.map((level) => level.colour));
    found.colours = table(gl, scene.colours);
    found.shapes = shapes(gl, scene.shapes);
    return found;
  }

  function relief(gl, scene, found, size) {
    const program = webgl.program(gl, source("relief-shader")), levels = 1 + Math.floor(Math.log2(Math.max(...size)));
    gl.useProgram(program.of);
    const [low, high] = scene.heights;
    gl.uniform1f(program.place("low"), low);
    gl.uniform1f(program.place("high"), high);
    const of = filled(gl, gl.R16F, size, program, { geometry: [found.geometry], k_s_status: [found.k_s] }, levels);
    gl.bindTexture(gl.TEXTURE_2D, of);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_NEAREST);
    gl.generateMipmap(gl.TEXTURE_2D);
    return of;
  }

  function table(gl, colours) {
    const of = webgl.texture(gl, gl.LINEAR), row = colours.flatMap((colour) => [...colour, 255]);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, colours.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(row));
    return of;
  }

  function shapes(gl, regions) {
    const of = webgl.texture(gl, gl.NEAREST), powers = Math.max(regions[0]?.length ?? 0, 1);
    const rows = new Float32Array(powers * Math.max(regions.length, 1));
    rows.set(regions.flat());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, powers, rows.length / powers, 0, gl.RED, gl.FLOAT, rows);
    return of;
  }

  async function photograph(gl, i) {
    const image = await picture(`photograph-${i}`, "jpeg"), of = webgl.texture(gl, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    return of;
  }

  return { load, photograph, bind };
})();
