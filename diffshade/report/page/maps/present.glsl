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

void main() {
  vec2 pixel = vec2(gl_FragCoord.x, height - gl_FragCoord.y), at = view_corner + pixel * view_stride;
  bool seen = all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, size));
  vec3 here = texture(picture, (at - corner) / (stride * vec2(textureSize(picture, 0)))).rgb;
#ifdef COMPARED
  if (pixel.x < wipe) {
    here = texture(photograph, at / size).rgb;
    if (exposure != 1.0) here = encoded(exposure * decoded(here));
  }
#endif
  colour = vec4(seen ? here : vec3(0.0), 1.0);
}
