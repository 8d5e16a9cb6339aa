"""Periodic motions of many scenes side by side: settling, shooting, monodromy, jumps, pairs of motions, basins."""
