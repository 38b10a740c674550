"""Diagnosis: what the photographs determine: examination, choice of models, plans, resampling, sensitivity."""
