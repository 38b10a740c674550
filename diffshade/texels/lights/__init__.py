"""Lights: found from the texels of an object, each of which has its own normal and coefficients."""
