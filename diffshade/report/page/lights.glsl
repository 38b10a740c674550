// What arrives from lights (E2, E3). The shader that includes this gives `lights`, a row an emitter; or defines DISTANT
// where the only one is at infinity, which is faster.

float logarithm(float x) {  // near 1 to the last digit, where log of a GPU is known to 2^-21 only
  if (x < 0.8 || x > 1.25) return log(x);
  float s = (x - 1.0) / (x + 1.0), q = s * s;
  return 2.0 * s * (1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0 + q / 9.0))));
}

#ifdef DISTANT
uniform vec3 toward, intensity;

vec3 arriving(int i, vec3 p, out vec3 l) {
  l = toward;
  return intensity;
}
#else
// laws
float radial(int law, float d) {  // E2
  // calls of laws
  return 1.0;
}

float angular(float cos_phi, float edge, float width, float exponent) {  // E3
  if (cos_phi < edge) return 0.0;
  float shape = cos_phi > 0.0 ? exp(exponent * logarithm(cos_phi)) : (exponent == 0.0 ? 1.0 : 0.0);
  float t = width > 0.0 ? min((cos_phi - edge) / width, 1.0) : 1.0;
  return shape * t * t * (3.0 - 2.0 * t);
}

vec3 arriving(int i, vec3 p, out vec3 l) {  // from an emitter at p: direction to it, and E2, E3
  vec4 place = texelFetch(lights, ivec2(0, i), 0), shine = texelFetch(lights, ivec2(1, i), 0);
  l = place.xyz;
  if (place.w == 0.0) return shine.rgb;  // at infinity
  vec4 axis = texelFetch(lights, ivec2(2, i), 0), cone = texelFetch(lights, ivec2(3, i), 0);
  vec3 to_light = place.xyz - p;
  float d = length(to_light);
  l = d > 0.0 ? to_light / d : vec3(0.0);
  vec3 found = shine.rgb * radial(int(shine.w), max(d, 1e-6));
  return cone.z > 0.0 ? found * angular(-dot(l, axis.xyz), axis.w, cone.y, cone.x) : found;
}
#endif
