"""Solve: where to start, and the steps to the minimum."""
