#version 300 es
// Heights for the shadows, from 0 to 1 of their range; below it where there is no object.
precision highp float;
precision highp sampler2D;

uniform sampler2D geometry, k_s_status;
uniform float low, high;

out vec4 height;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  bool inside = texelFetch(k_s_status, at, 0).a > 0.5;
  height = vec4(inside ? (texelFetch(geometry, at, 0).a - low) / (high - low) : -1.0, 0.0, 0.0, 1.0);
}
