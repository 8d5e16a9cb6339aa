"""Curves of harmonic balance of a study: for each set of values of its further axes, here or on processes."""
