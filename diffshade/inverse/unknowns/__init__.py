"""Unknowns: which numbers of a scene are fitted, their names, ranges and constraints."""
