"""Calibration: camera, lights and intensities from photographs of a ball."""
