#version 300 es
// The texels of the maps, by the equations of diffshade (E4-E9) and what photographs show beyond them. picture.js
// defines what a picture needs, since a machine without a graphics card computes both sides of every branch:
// DISTANT, BEYOND, SHADOWS and OVERLAY where there are any; POINTS and LOCAL_VIEWER; LOBE; POWERS of a highlight that
// the texels of a region share; SHAPE, to add them where all share one; OWN where what needs no light is not the same for
// all texels.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D geometry, k_d_n_s, k_s_status, own_region;  // numbers, and one beside them
uniform sampler2D lights;  // a row an emitter
uniform int count;
uniform sampler2D shapes;   // a row a region: the weight of each power of its highlight, each power twice the one before
uniform float first_power;
uniform sampler2D beyond;   // what beyond.glsl made
uniform float coarser;      // how many texels a number of it, or an error, is wide
uniform sampler2D passing;  // by the heights, of the light of each of the first four emitters
uniform float diffuse, specular;  // what k_d and k_s are multiplied by
uniform vec3 own;           // what needs no light: k_e + k_a I_a
uniform float gain, black, exposure, opacity;
uniform vec2 size, corner, stride;  // of the maps; where the picture's first pixel begins and how wide it is, texels

uniform sampler2D colours, palette;
uniform vec3 towards_right, towards_up;
uniform sampler2D numbers;  // that the overlay shows, in the channel `pick`
uniform vec4 pick;
uniform float numbers_coarser, overlay_low, overlay_high, unknown;
uniform bool logarithmic;

out vec4 colour;  // as it is shown, times whether it is the object

vec3 k_d, k_s, n_s;
const float eta = 1.0;
const int fresnel = 0, lobe = LOBE;

// include maps/place.glsl
// include lights.glsl
// include reflection.glsl
// include srgb.glsl

#if defined(SHAPE) || defined(POWERS)
float shaped_highlight(vec3 n, vec3 l, vec3 v, int region) {  // a sum of powers
  float total = 0.0;
#ifdef SHAPE
  float power = max(cosine(n, l, v), 0.0);
  SHAPE
#else
  n_s = vec3(first_power);
  float power = highlight(n, l, v).r;
  for (int j = 0; j < POWERS; j++) {
    total += texelFetch(shapes, ivec2(j, region), 0).r * power;
    power *= power;
  }
#endif
  return total;
}
#define SHARED
#endif

#ifdef OVERLAY
vec3 colour_of(float value) {
  float t = logarithmic ? log(max(value, 1e-30) / overlay_low) / log(overlay_high / overlay_low)
                        : (value - overlay_low) / (overlay_high - overlay_low);
  return texture(colours, vec2(clamp(t, 0.002, 0.998), 0.5)).rgb;
}

vec3 overlay_at(vec2 at, vec3 n, float status) {  // 1 normals, 2 a colour, 3 the status, 4 a number
  ivec2 there = ivec2(min(at / numbers_coarser, vec2(textureSize(numbers, 0) - 1)));
  if (OVERLAY == 1) return 0.5 + 0.5 * vec3(dot(n, towards_right), dot(n, towards_up), dot(n, backward));
  if (OVERLAY == 2) return encoded(texelFetch(numbers, there, 0).rgb / overlay_high);
  if (OVERLAY == 3) return texelFetch(palette, ivec2(int(status + 0.5), 0), 0).rgb;
  float value = dot(pick, texelFetch(numbers, there, 0));
  if (unknown > 0.0) {  // integers of errors, on the scale's own curve
    value = round(255.0 * value);
    if (value == unknown) return vec3(mod(floor(at.x / 2.0) + floor(at.y / 2.0), 2.0) * 0.12 + 0.3);
    return texture(colours, vec2(clamp(value / 254.0, 0.002, 0.998), 0.5)).rgb;
  }
  return colour_of(value);
}
#endif

vec3 shown(int i, vec3 n, vec3 p, vec3 v, int region, vec4 passes) {  // of an emitter's light
  vec3 l;
  vec3 light = arriving(i, p, l);
  float n_l = dot(n, l);
#ifdef SHARED
  vec3 shine = vec3(shaped_highlight(n, l, v, region));
#else
  vec3 shine = highlight(n, l, v);
#endif
#ifdef SHADOWS
  if (i < 4) light *= passes[i];
#endif
  return n_l > 0.0 ? light * (k_d * n_l + weight(n_l) * shine) : vec3(0.0);  // E4
}

void main() {
  vec2 at = corner + gl_FragCoord.xy * stride;
  ivec2 texel = ivec2(clamp(at, vec2(0.0), size - 1.0));
  vec4 specular_status = texelFetch(k_s_status, texel, 0), diffuse_n_s = texelFetch(k_d_n_s, texel, 0);
  vec4 surface = texelFetch(geometry, texel, 0);
  vec3 n = surface.xyz, p = vec3(0.0), v = backward;
#ifdef POINTS
  p = point(vec2(texel) + 0.5, surface.a);
#endif
#ifdef LOCAL_VIEWER
  v = normalize(eye - p);  // E8
#endif
  k_d = diffuse * diffuse_n_s.rgb;
  k_s = specular * specular_status.rgb;
  n_s = vec3(diffuse_n_s.a);
  vec3 total = own;
  int region = 0;
#if defined(OWN) || defined(POWERS)
  vec4 own_here = texelFetch(own_region, texel, 0);
  total = own_here.rgb;
  region = int(own_here.a + 0.5);
#endif
  vec4 passes = vec4(1.0);
#ifdef SHADOWS
  passes = texture(passing, at / size);
#endif
#ifdef DISTANT
  total += shown(0, n, p, v, region, passes);
#else
  for (int i = 0; i < count; i++) total += shown(i, n, p, v, region, passes);  // E9
#endif
  total *= gain;
#ifdef BEYOND
  total += coarser > 1.0 ? texture(beyond, at / (coarser * vec2(textureSize(beyond, 0)))).rgb
                         : texelFetch(beyond, texel, 0).rgb;
#endif
  vec3 picture = encoded(exposure * (max(total, 0.0) + black));
#ifdef OVERLAY
  picture = mix(picture, overlay_at(at, n, specular_status.a), opacity);
#endif
  bool inside = specular_status.a > 0.5 && all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, size));
  colour = inside ? vec4(picture, 1.0) : vec4(0.0);
}
