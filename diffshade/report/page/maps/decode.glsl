#version 300 es
// Integers of a layer become numbers, once: three of the layer `first`, and one of `index` beside them.
precision highp float;
precision highp int;
precision highp sampler2D;

struct Layer {
  vec3 steps, low, high;
  ivec3 curve;
  float bytes;  // 1 or 2
};
uniform Layer layer, index_layer;
uniform sampler2D low_bytes, high_bytes, index_low_bytes, index_high_bytes;
uniform int beside;     // which channel of the index
uniform bool geometry;  // whether the layer has a folded normal and a height

out vec4 numbers;

float number(float t, float low, float high, int curve) {
  if (curve == 1) return high * t * t;
  float s = 2.0 * t - 1.0;
  if (curve == 2) return high * s * abs(s);
  if (curve == 3) return low * exp(t * log(high / low));
  return low + (high - low) * t;
}

vec3 decoded(Layer of, vec3 low, vec3 high) {
  vec3 integers = round(255.0 * low) + (of.bytes > 1.0 ? 256.0 * round(255.0 * high) : vec3(0.0));
  vec3 t = integers / of.steps;
  return vec3(number(t.x, of.low.x, of.high.x, of.curve.x), number(t.y, of.low.y, of.high.y, of.curve.y),
              number(t.z, of.low.z, of.high.z, of.curve.z));
}

vec3 unfolded(vec2 p) {  // an octahedron's point (Cigolle et al. 2014)
  float z = 1.0 - abs(p.x) - abs(p.y);
  vec2 signs = vec2(p.x >= 0.0 ? 1.0 : -1.0, p.y >= 0.0 ? 1.0 : -1.0);
  return normalize(vec3(z < 0.0 ? (1.0 - abs(p.yx)) * signs : p, z));
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 of = decoded(layer, texelFetch(low_bytes, at, 0).rgb, texelFetch(high_bytes, at, 0).rgb);
  if (geometry) {
    numbers = vec4(unfolded(of.xy), of.z);
    return;
  }
  vec3 index = decoded(index_layer, texelFetch(index_low_bytes, at, 0).rgb, texelFetch(index_high_bytes, at, 0).rgb);
  numbers = vec4(of, index[beside]);
}
