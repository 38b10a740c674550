"""Pixels: the samples that count, in blocks of equal size."""
