"""Lamps: IES and EULUMDAT files, and laws fitted to measured falloffs."""
