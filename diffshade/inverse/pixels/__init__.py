"""Pixels: the samples that count, in blocks, tiles and streams."""
