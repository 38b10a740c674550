#version 300 es
// What lights show beyond the model: the sum of its parts, once for all pixels that show a texel. picture.js defines
// PARTS, how many there are; and of one light at infinity SUM, which adds them.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

uniform sampler2D geometry, lights;
uniform sampler2D weights;  // a row an emitter: of each part of its light
uniform float weight[PARTS];  // of the only light at infinity
uniform sampler2DArray parts;
uniform int count;
uniform float coarser;      // how many texels a number is wide
uniform float gain;

out vec4 beyond;

// include maps/place.glsl
// include lights.glsl

vec3 part(ivec2 at, int k) {
  return texelFetch(parts, ivec3(at, k), 0).rgb;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 total = vec3(0.0), p = vec3(0.0);
#ifdef POINTS
  ivec2 texel = min(ivec2(gl_FragCoord.xy * coarser), textureSize(geometry, 0) - 1);
  p = point(vec2(texel) + 0.5, texelFetch(geometry, texel, 0).a);
#endif
#ifdef SUM
  SUM
  total *= intensity;
#else
  for (int i = 0; i < count; i++) {
    vec3 l, of = vec3(0.0);
    vec3 light = arriving(i, p, l);
    for (int k = 0; k < PARTS; k++) of += texelFetch(weights, ivec2(k, i), 0).r * part(at, k);
    total += light * of;
  }
#endif
  beyond = vec4(gain * total, 1.0);
}
