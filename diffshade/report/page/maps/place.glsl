// Points of the surface and the camera that sees them: p = origin - h direction at the height h, both affine in the
// column and row. Lengths are scene units, seen from the camera's target.
uniform vec3 origin, origin_column, origin_row, direction, direction_column, direction_row;
uniform vec3 eye, backward;
uniform bool local_viewer;

vec3 point(vec2 at, float h) {
  return origin + origin_column * at.x + origin_row * at.y
       - h * (direction + direction_column * at.x + direction_row * at.y);
}
