#version 300 es
// One material on one sphere, by the equations of diffshade (E1-E9). Lengths are scene units, seen from the centre.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform vec3 origin, origin_column, origin_row;           // of a pixel's ray, affine in its column and row,
uniform vec3 direction, direction_column, direction_row;  // where it passes the plane through the centre
uniform vec3 eye, backward;
uniform bool local_viewer;
uniform float radius, height;
uniform vec3 ambient, background, k_a, k_d, k_s, k_e, n_s;
uniform float eta;
uniform int lobe;     // 0 Phong, 1 Blinn, from 2 on those of own_highlight
uniform int fresnel;  // 0 none, 1 Schlick, 2 dielectric
uniform sampler2D lights;  // a row an emitter
uniform int count;
uniform float gain, black;

out vec4 colour;

// include lights.glsl
// include reflection.glsl
// include srgb.glsl

vec3 reflected(vec3 p, vec3 n, vec3 v) {  // E9
  vec3 total = k_e + k_a * ambient;
  for (int i = 0; i < count; i++) {
    vec3 l;
    vec3 light = arriving(i, p, l);
    float n_l = dot(n, l);
    if (n_l > 0.0) total += light * (k_d * n_l + weight(n_l) * highlight(n, l, v));  // E4
  }
  return total;
}

void main() {
  float column = gl_FragCoord.x, row = height - gl_FragCoord.y;
  vec3 o = origin + origin_column * column + origin_row * row;
  vec3 d = normalize(direction + direction_column * column + direction_row * row);
  float nearest = -dot(o, d);
  vec3 miss = o + d * nearest;
  float half_chord2 = radius * radius - dot(miss, miss);
  vec3 radiance = background;
  if (half_chord2 > 0.0) {
    vec3 n = normalize(o + d * (nearest - sqrt(half_chord2))), p = n * radius;
    radiance = reflected(p, n, local_viewer ? normalize(eye - p) : backward);  // E8
  }
  colour = vec4(encoded(gain * radiance + black), 1.0);
}
