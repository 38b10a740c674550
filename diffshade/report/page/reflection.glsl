// What a point reflects (E5-E7). The shader that includes this gives its k_s, n_s and eta; lobe, 0 Phong, 1 Blinn, from 2
// on those of own_highlight; fresnel, 0 none, 1 Schlick, 2 dielectric. It includes lights.glsl first.

vec3 power(float x, vec3 n) {
  return x > 0.0 ? exp(n * logarithm(x)) : vec3(0.0);
}

float squared_ratio(float a, float b) {
  float ratio = a + b > 0.0 ? (a - b) / (a + b) : 0.0;
  return ratio * ratio;
}

vec3 weight(float n_l) {  // E7
  if (fresnel == 1) {
    float c = 1.0 - n_l, fifth = c * c * c * c * c;
    return k_s + (1.0 - k_s) * fifth;
  }
  if (fresnel == 2) {
    float eta2 = eta * eta, g2 = eta2 - 1.0 + n_l * n_l;
    if (g2 <= 0.0) return vec3(1.0);
    float g = sqrt(g2);
    return vec3(0.5 * (squared_ratio(n_l, g) + squared_ratio(eta2 * n_l, g)));
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

float cosine(vec3 n, vec3 l, vec3 v) {  // E5, E6
  return lobe == 0 ? dot(v, 2.0 * dot(n, l) * n - l) : dot(n, halfway(l, v));
}

vec3 highlight(vec3 n, vec3 l, vec3 v) {
  return lobe > 1 ? own_highlight(n, l, v) : power(cosine(n, l, v), n_s);
}
