"""Periodic motions of many scenes: settling, shooting, monodromy, jumps, pairs of motions, basins."""
