#version 300 es
// Shadows without slits: the median of nine places about each, which single texels and thin lines do not change. It is
// that of each column sorted: of the greatest low, the middle middle and the least high (Smith 1996).
precision highp float;
precision highp sampler2D;

uniform sampler2D shadow;
uniform vec2 target_size;
uniform float apart;  // texels

out vec4 passing;

vec4 middle(vec4 a, vec4 b, vec4 c) {
  return max(min(a, b), min(max(a, b), c));
}

void main() {
  vec4 low = vec4(0.0), high = vec4(1.0), middles[3];
  for (int i = 0; i < 3; i++) {
    vec4 of[3];
    for (int j = 0; j < 3; j++) of[j] = texture(shadow, (gl_FragCoord.xy + apart * vec2(i - 1, j - 1)) / target_size);
    low = max(low, min(min(of[0], of[1]), of[2]));
    high = min(high, max(max(of[0], of[1]), of[2]));
    middles[i] = middle(of[0], of[1], of[2]);
  }
  passing = middle(low, middle(middles[0], middles[1], middles[2]), high);
}
