"""Texels: a fit of its own at every pixel of views that share a camera, and the maps that come of it."""
