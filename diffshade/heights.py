"""Heights of an object from the normals of its texels, with errors, and their mesh.

`integrate_normals` returns a `HeightMap`, and `height_mesh` makes a `HeightMesh` of it, which `exchange.write_mesh`
writes.
"""

from .texels.heights.integration import integrate_normals as integrate_normals
from .texels.heights.map import HeightMap as HeightMap
from .texels.heights.mesh import HeightMesh as HeightMesh
from .texels.heights.mesh import height_mesh as height_mesh
