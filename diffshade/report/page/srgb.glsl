// The curve of sRGB, IEC 61966-2-1.

vec3 encoded(vec3 x) {
  x = clamp(x, 0.0, 1.0);
  vec3 a = sqrt(x), b = sqrt(a), c = sqrt(b);  // 1.055 x^(1/2.4) - 0.055 within 0.012 / 255, and faster
  vec3 root = 0.6423692 * a + 0.7121063 * b - 0.3368682 * c - 0.0175643 * x;
  return mix(root, 12.92 * x, lessThanEqual(x, vec3(0.0031308)));
}

vec3 decoded(vec3 x) {
  return mix(pow((x + 0.055) / 1.055, vec3(2.4)), x / 12.92, lessThanEqual(x, vec3(0.04045)));
}
