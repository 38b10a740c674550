"""Texels: a fit at every pixel of views that share a camera, and the maps that result."""
