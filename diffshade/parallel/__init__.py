"""Parallel: threads, devices of a mesh, and the files that a long run resumes from; independent of any fit."""
