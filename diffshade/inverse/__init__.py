"""Inverse: from photographs to the scene's numbers; the subpackages follow the path of the data."""
