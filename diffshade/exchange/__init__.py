"""Materials, meshes, lights and relightable images, to and from the files of other programs.

`write_material` and `read_material` know Wavefront MTL, glTF, three.js, POV-Ray, OpenGL, VTK and metallic-roughness;
`read_materials` and `read_lights` read all that a file holds. `with_lobe` finds the nearest material with another lobe,
and `material_error` says how far a named material is from its measurement. `read_mesh` and `read_mesh_parts` give what
a camera sees of a mesh, and `frame_mesh` a camera that sees it whole; `write_mesh` writes the mesh of heights with its
maps. `write_rti` writes maps as a folder or `.ptm` file for viewers of relightable images; `read_rti` reads one, and
`photographs_of` makes photographs of it.
"""

from ..inverse.data.relightable import photographs_of as photographs_of
from ..io.meshes import frame_mesh as frame_mesh
from ..io.meshes import read_mesh as read_mesh
from ..io.meshes import read_mesh_parts as read_mesh_parts
from ..io.rti_files import RelightableImage as RelightableImage
from ..io.rti_files import read_rti as read_rti
from ..model.named_materials import material_error as material_error
from .lobe_refits import with_lobe as with_lobe
from .material_files import read_lights as read_lights
from .material_files import read_material as read_material
from .material_files import read_materials as read_materials
from .material_files import write_material as write_material
from .mesh_files import write_mesh as write_mesh
from .rti_folders import write_rti as write_rti
