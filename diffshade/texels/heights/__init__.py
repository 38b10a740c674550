"""Heights: from a map of normals to a height field with errors."""
