"""Harmonic balance: the contact law through a period, the residual, continuation, stability and response curves."""
