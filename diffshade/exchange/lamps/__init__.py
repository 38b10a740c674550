"""Lamps: IES and EULUMDAT files, and attenuation fitted to measured falloff."""
