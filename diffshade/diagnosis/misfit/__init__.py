"""Misfit: what in the scene description the residuals contradict."""
