"""Verdicts: what `fit` tests at the minimum before it calls a number determined."""
