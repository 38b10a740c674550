"""Inverse: from photographs to the scene's numbers; its rooms follow the way of the data."""
