#version 300 es
// How much of the light of the first four emitters passes the heights: a march from each point towards the light.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D relief, lights;
uniform int count;
uniform vec2 size;  // of the maps, texels
uniform vec2 target_size;
uniform float texel, low, high;  // scene units
uniform float growth;       // a step, of the way so far: as the penumbra grows
uniform mat4 to_pixel;

const int STEPS = 200;
const float PENUMBRA = 0.05;  // tangent of the angle over which a shadow's edge fades

out vec4 passing;

// include maps/place.glsl
// include lights.glsl

float height_at(vec2 at, float level) {
  return low + (high - low) * textureLod(relief, at / size, level).r;
}

float passed(vec3 p, float h, vec3 l) {
  float across = length(l - dot(l, backward) * backward);
  if (across < 1e-3) return 1.0;
  float per_texel = texel / across, covered = 0.0, way = 1.0;
  float rise = dot(l, backward), least = max(1.0, 0.5 * size.x / target_size.x);  // texels
  for (int i = 0; i < STEPS; i++) {
    float stride = max(least, growth * way);
    way += stride;
    float t = way * per_texel;
    float ray = h + t * rise;
    if (ray > high || ray < low) break;
    vec4 seen = vec4(p + t * l, 1.0) * to_pixel;
    vec2 at = seen.xy / seen.z;
    if (any(lessThan(at, vec2(0.0))) || any(greaterThan(at, size))) break;
    covered = max(covered, (height_at(at, log2(stride)) - ray) / t);
    if (covered > PENUMBRA) return 0.0;
  }
  return 1.0 - smoothstep(0.0, PENUMBRA, covered);
}

void main() {
  vec2 at = gl_FragCoord.xy / target_size * size;
  float h = height_at(at, 0.0);
  vec3 p = point(at, h);
  vec4 found = vec4(1.0);
  for (int i = 0; i < min(count, 4); i++) {
    vec3 l;
    arriving(i, p, l);
    found[i] = passed(p, h, l);
  }
  passing = found;
}
