"""Misfit: where the residuals contradict the scene description."""
