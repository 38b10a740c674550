#version 300 es
// The picture on the canvas; with COMPARED, the photograph left of a line.
precision highp float;
precision highp sampler2D;

uniform sampler2D picture, photograph;
uniform vec2 size, corner;      // of the maps; where the picture begins, texels
uniform float stride;           // how many texels a pixel of the picture is wide
uniform vec2 view_corner;       // where the canvas begins, texels
uniform float view_stride;      // how many texels a pixel of the canvas is wide
uniform float height, exposure, wipe;  // pixels of the canvas

out vec4 colour;

// include srgb.glsl

vec4 around(vec2 at) {  // the mean of the texels about a place: what a silhouette is cut from, smoother than their sides
  vec2 whole = vec2(textureSize(picture, 0));
  vec4 total = vec4(0.0);
  for (int i = 0; i < 4; i++) total += texture(picture, (at + vec2(i & 1, i >> 1) - 0.5) / whole);
  return 0.25 * total;
}

void main() {
  vec2 pixel = vec2(gl_FragCoord.x, height - gl_FragCoord.y), at = view_corner + pixel * view_stride;
  bool seen = all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, size));
  vec2 place = (at - corner) / stride;
  vec4 of = texture(picture, place / vec2(textureSize(picture, 0)));
  vec3 here = of.rgb;
  if (view_stride < stride) {  // texels are wider than pixels
    vec4 mean = around(place);
    float edge = clamp((mean.a - 0.5) / max(fwidth(mean.a), 1e-3) + 0.5, 0.0, 1.0);
    here = edge * (of.a > 0.0 ? of.rgb / of.a : mean.rgb / max(mean.a, 1e-3));
  }
#ifdef COMPARED
  if (pixel.x < wipe) {
    here = texture(photograph, at / size).rgb;
    if (exposure != 1.0) here = encoded(exposure * decoded(here));
  }
#endif
  colour = vec4(seen ? here : vec3(0.0), 1.0);
}
