"""Parallel: threads, devices of a mesh, and what a long run keeps on disk; knows nothing of fits."""
