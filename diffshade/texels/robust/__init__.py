"""Robust fits of texels with their normals: photographs of real objects, which no model obeys everywhere."""
