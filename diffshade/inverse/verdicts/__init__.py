"""Verdicts: what `fit` tests at the minimum before it calls a number determined.

Each is a function of a `Fit` that returns it with fewer determined numbers, larger errors or more notes.
"""
