"""Lamps: the spot light nearest to one, and attenuation fitted to measured falloff."""
