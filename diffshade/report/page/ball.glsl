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

float logarithm(float x) {  // near 1 to the last digit, where log of a GPU is known to 2^-21 only
  if (x < 0.8 || x > 1.25) return log(x);
  float s = (x - 1.0) / (x + 1.0), q = s * s;
  return 2.0 * s * (1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0 + q / 9.0))));
}

vec3 power(float x, vec3 n) {
  return x > 0.0 ? exp(n * logarithm(x)) : vec3(0.0);
}

float radial(vec3 a, float d, bool clamped) {  // E2
  d = max(d, 1e-6);
  float f = 1.0 / (a.x + d * (a.y + d * a.z));
  return clamped ? min(f, 1.0) : f;
}

float angular(float cos_phi, float edge, float width, float exponent) {  // E3
  if (cos_phi < edge) return 0.0;
  float shape = cos_phi > 0.0 ? exp(exponent * logarithm(cos_phi)) : (exponent == 0.0 ? 1.0 : 0.0);
  float t = width > 0.0 ? min((cos_phi - edge) / width, 1.0) : 1.0;
  return shape * t * t * (3.0 - 2.0 * t);
}

float squared_ratio(float a, float b) {
  float ratio = a + b > 0.0 ? (a - b) / (a + b) : 0.0;
  return ratio * ratio;
}

vec3 weight(float cosine) {  // E7
  if (fresnel == 1) {
    float c = 1.0 - cosine, fifth = c * c * c * c * c;
    return k_s + (1.0 - k_s) * fifth;
  }
  if (fresnel == 2) {
    float eta2 = eta * eta, g2 = eta2 - 1.0 + cosine * cosine;
    if (g2 <= 0.0) return vec3(1.0);
    float g = sqrt(g2);
    return vec3(0.5 * (squared_ratio(cosine, g) + squared_ratio(eta2 * cosine, g)));
  }
  return k_s;
}

vec3 halfway(vec3 l, vec3 v) {
  vec3 h = l + v;
  float squared = dot(h, h);
  return squared > 1e-12 ? h * inversesqrt(squared) : vec3(0.0);
}

// own functions
vec3 own_highlight(vec3 n, vec3 l, vec3 v) {
  // own calls
  return vec3(0.0);
}

vec3 highlight(vec3 n, vec3 l, vec3 v) {  // E5, E6
  if (lobe > 1) return own_highlight(n, l, v);
  return power(lobe == 0 ? dot(v, 2.0 * dot(n, l) * n - l) : dot(n, halfway(l, v)), n_s);
}

vec3 reflected(vec3 p, vec3 n, vec3 v) {  // E9
  vec3 total = k_e + k_a * ambient;
  for (int i = 0; i < count; i++) {
    vec4 place = texelFetch(lights, ivec2(0, i), 0), shine = texelFetch(lights, ivec2(1, i), 0);
    vec4 fade = texelFetch(lights, ivec2(2, i), 0), axis = texelFetch(lights, ivec2(3, i), 0);
    vec4 cone = texelFetch(lights, ivec2(4, i), 0);
    vec3 l = place.xyz, arriving = shine.rgb;
    if (place.w > 0.0) {  // it stands somewhere
      vec3 to_light = place.xyz - p;
      float d = length(to_light);
      l = d > 0.0 ? to_light / d : vec3(0.0);
      arriving *= radial(fade.xyz, d, shine.w > 0.0);
      if (fade.w > 0.0) arriving *= angular(-dot(l, axis.xyz), axis.w, cone.y, cone.x);
    }
    float n_l = dot(n, l);
    if (n_l <= 0.0) continue;
    total += arriving * (k_d * n_l + weight(n_l) * highlight(n, l, v));  // E4
  }
  return total;
}

vec3 encoded(vec3 x) {  // sRGB, IEC 61966-2-1
  x = clamp(x, 0.0, 1.0);
  return mix(1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, 12.92 * x, lessThanEqual(x, vec3(0.0031308)));
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
