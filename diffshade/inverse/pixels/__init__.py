"""Pixels: the samples that count, in blocks of equal size, and read by tiles of rows."""
