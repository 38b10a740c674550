"use strict";
// What every picture drawn by WebGL 2 needs: vectors, programs that fill a canvas, textures.
const vectors = (() => {
  const add = (a, b, t = 1) => a.map((x, i) => x + t * b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const turned = (a, axis, angle) => {  // about a unit axis, right-handed (Rodrigues)
    const c = Math.cos(angle), s = Math.sin(angle), along = dot(axis, a) * (1 - c);
    const across = cross(axis, a);
    return a.map((x, i) => x * c + across[i] * s + axis[i] * along);
  };
  return { add, dot, cross, turned };
})();

const webgl = (() => {
  const WHOLE = "#version 300 es\nin vec2 corner;\nvoid main() { gl_Position = vec4(corner, 0.0, 1.0); }";

  function program(gl, fragments, defined = {}) {  // one that draws the whole target; null where it does not compile
    const defines = Object.entries(defined).map(([name, value]) => `#define ${name} ${value}\n`).join("");
    const of = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, WHOLE], [gl.FRAGMENT_SHADER, fragments.trim().replace("\n", `\n${defines}`)]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(of, shader);
    }
    gl.bindAttribLocation(of, 0, "corner");
    gl.linkProgram(of);
    if (!gl.getProgramParameter(of, gl.LINK_STATUS)) return null;
    gl.disable(gl.DITHER);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    const places = {};
    return { of, place: (name) => (places[name] ??= gl.getUniformLocation(of, name)) };
  }

  function texture(gl, filter, target = gl.TEXTURE_2D) {
    const of = gl.createTexture();
    gl.bindTexture(target, of);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, side, filter);
    for (const axis of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, axis, gl.CLAMP_TO_EDGE);
    return of;
  }

  return { program, texture };
})();
