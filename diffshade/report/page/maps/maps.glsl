#version 300 es
// The texels of the maps, by the equations of diffshade (E4-E9) and what photographs show beyond them.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

uniform sampler2D geometry, k_d_n_s, k_s_status, own_region;  // numbers, and one beside them
uniform sampler2D lights;  // a row an emitter
uniform int count;
uniform int lobe;
uniform sampler2D shapes;   // a row a region: the weight of each power of its highlight, each power twice the one before
uniform int powers;         // 0 where each texel has its n_s
uniform float first_power;
uniform sampler2DArray beyond;
uniform int parts;          // of the light beyond the model; 0 where it is left out
uniform float coarser;      // how many texels a number of theirs, or an error, is wide
uniform sampler2D passing;  // by the heights, of the light of each of the first four emitters
uniform bool placed;  // whether points are known
uniform bool with_shadows, with_diffuse;
uniform float specular;        // what k_s is multiplied by
uniform float gain, black, exposure, opacity;
uniform vec2 size, corner, stride;  // of the maps; where the picture's first pixel begins and how wide it is, texels

uniform int overlay;  // 0 none, 1 normals, 2 a colour, 3 the status, 4 a number
uniform sampler2D colours, palette;
uniform vec3 towards_right, towards_up;
uniform sampler2D numbers;  // that the overlay shows, in the channel `pick`
uniform vec4 pick;
uniform float numbers_coarser, overlay_low, overlay_high, unknown;
uniform bool logarithmic;

out vec4 colour;  // as it is shown, times whether it is the object

vec3 k_d, k_s, n_s;
const float eta = 1.0;
const int fresnel = 0;

// include maps/place.glsl
// include lights.glsl
// include reflection.glsl
// include srgb.glsl

vec3 shaped_highlight(vec3 n, vec3 l, vec3 v, int region) {  // the sum of powers that texels share, or their own
  if (powers == 0) return highlight(n, l, v);
  n_s = vec3(first_power);
  vec3 power = highlight(n, l, v), total = vec3(0.0);
  for (int j = 0; j < powers; j++) {
    total += texelFetch(shapes, ivec2(j, region), 0).r * power;
    power *= power;
  }
  return total;
}

vec3 part(vec2 place, ivec2 texel, int k) {
  return coarser > 1.0 ? texture(beyond, vec3(place, k)).rgb : texelFetch(beyond, ivec3(texel, k), 0).rgb;
}

vec3 beyond_of(int i, vec2 at) {  // what light of one unit from an emitter shows beyond the model
  vec3 total = vec3(0.0);
  vec2 place = at / (coarser * vec2(textureSize(beyond, 0).xy));
  ivec2 texel = ivec2(at);
  for (int k = 0; k < parts; k += 3) {
    vec3 weights = texelFetch(lights, ivec2(5 + k / 3, i), 0).xyz;
    total += weights.x * part(place, texel, k);
    if (k + 1 < parts) total += weights.y * part(place, texel, k + 1);
    if (k + 2 < parts) total += weights.z * part(place, texel, k + 2);
  }
  return total;
}

vec3 colour_of(float value) {
  float t = logarithmic ? log(max(value, 1e-30) / overlay_low) / log(overlay_high / overlay_low)
                        : (value - overlay_low) / (overlay_high - overlay_low);
  return texture(colours, vec2(clamp(t, 0.002, 0.998), 0.5)).rgb;
}

vec4 overlay_at(vec2 at, vec3 n, float status) {
  ivec2 there = ivec2(min(at / numbers_coarser, vec2(textureSize(numbers, 0) - 1)));
  if (overlay == 1) return vec4(0.5 + 0.5 * vec3(dot(n, towards_right), dot(n, towards_up), dot(n, backward)), 1.0);
  if (overlay == 2) return vec4(encoded(texelFetch(numbers, there, 0).rgb / overlay_high), 1.0);
  if (overlay == 3) return vec4(texelFetch(palette, ivec2(int(status + 0.5), 0), 0).rgb, 1.0);
  if (overlay != 4) return vec4(0.0);
  float value = dot(pick, texelFetch(numbers, there, 0));
  if (unknown > 0.0) {  // integers of errors, on the scale's own curve
    value = round(255.0 * value);
    if (value == unknown) return vec4(mod(floor(at.x / 2.0) + floor(at.y / 2.0), 2.0) * vec3(0.12) + 0.3, 1.0);
    return vec4(texture(colours, vec2(clamp(value / 254.0, 0.002, 0.998), 0.5)).rgb, 1.0);
  }
  return vec4(colour_of(value), 1.0);
}

void main() {
  vec2 at = corner + gl_FragCoord.xy * stride;
  colour = vec4(0.0);
  if (any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, size))) return;
  ivec2 texel = ivec2(at);
  vec4 specular_status = texelFetch(k_s_status, texel, 0);
  if (specular_status.a < 0.5) return;  // outside
  vec4 surface = texelFetch(geometry, texel, 0), diffuse = texelFetch(k_d_n_s, texel, 0);
  vec4 own = texelFetch(own_region, texel, 0);
  vec3 n = surface.xyz, p = placed ? point(vec2(texel) + 0.5, surface.a) : vec3(0.0);
  vec3 v = local_viewer ? normalize(eye - p) : backward;  // E8
  k_d = with_diffuse ? diffuse.rgb : vec3(0.0);
  k_s = specular * specular_status.rgb;
  bool shines = max(k_s.r, max(k_s.g, k_s.b)) > 0.0;
  vec4 passes = with_shadows ? texture(passing, at / size) : vec4(1.0);
  vec3 total = own.rgb;
  for (int i = 0; i < count; i++) {  // E9
    vec3 l;
    vec3 light = arriving(i, p, l);
    float n_l = dot(n, l), passed = i < 4 ? passes[i] : 1.0;
    n_s = vec3(diffuse.a);
    if (n_l > 0.0) {  // E4
      vec3 shine = shines ? weight(n_l) * shaped_highlight(n, l, v, int(own.a + 0.5)) : vec3(0.0);
      total += passed * light * (k_d * n_l + shine);
    }
    if (parts > 0) total += light * beyond_of(i, at);
  }
  vec3 picture = encoded(exposure * (gain * max(total, 0.0) + black));
  vec4 above = overlay == 0 ? vec4(0.0) : overlay_at(at, n, specular_status.a);
  colour = vec4(mix(picture, above.rgb, opacity * above.a), 1.0);
}
