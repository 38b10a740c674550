"""Diagnosis: what the photographs determine beyond one fit: examination, choice of models, plans, resampling."""
