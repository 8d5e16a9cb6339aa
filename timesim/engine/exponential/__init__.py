"""Exponential integration: the exact flow of the modes, and the collocation of the contact forces on it."""
