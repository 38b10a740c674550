"""Diagnosis: how far a fit can be trusted, which of several to believe, and which photograph to take next."""
