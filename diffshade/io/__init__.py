"""Files: images, masks, meshes and scene files, read and written."""
