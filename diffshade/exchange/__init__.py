"""Materials, meshes and relightable images, to and from the files of other programs.

`write_material` writes Wavefront MTL, glTF, and what three.js, POV-Ray, OpenGL and VTK take; `read_material` and
`read_materials` read MTL, glTF and three.js's JSON. `with_lobe` finds the nearest material with another lobe, and
`material_error` says how far a named material is from its measurement. `read_mesh` and `read_mesh_parts` give what a
camera sees of a mesh, `read_mesh_objects` in the materials and textures of its file, and `frame_mesh` a camera that
sees it whole; `write_mesh` writes the mesh of heights with its maps. `write_rti` writes maps as a folder or `.ptm` file
for viewers of relightable images; `read_rti` reads one, and `photographs_of` makes photographs of it.
"""

import lazy_loader

# a module of this room, such as that of materials, does not load those of meshes and maps; __init__.pyi is for types
__getattr__, __dir__, __all__ = lazy_loader.attach(
    "diffshade",
    submod_attrs={
        "inverse.data.relightable": ["photographs_of"],
        "io.meshes": ["frame_mesh", "read_mesh", "read_mesh_parts"],
        "io.rti_files": ["RelightableImage", "read_rti"],
        "model.named_materials": ["material_error"],
        "exchange.lobe_refits": ["with_lobe"],
        "exchange.material_files": ["read_material", "read_materials", "write_material"],
        "exchange.mesh_files": ["write_mesh"],
        "exchange.mesh_objects": ["read_mesh_objects"],
        "exchange.rti_folders": ["write_rti"],
    },
)
