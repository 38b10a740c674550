// The curve of sRGB, IEC 61966-2-1.

vec3 encoded(vec3 x) {
  x = clamp(x, 0.0, 1.0);
  return mix(1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, 12.92 * x, lessThanEqual(x, vec3(0.0031308)));
}

vec3 decoded(vec3 x) {
  return mix(pow((x + 0.055) / 1.055, vec3(2.4)), x / 12.92, lessThanEqual(x, vec3(0.04045)));
}
