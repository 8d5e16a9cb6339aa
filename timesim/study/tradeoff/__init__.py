"""Error against time for a scene: methods, tolerances, modes kept and reductions, timed within a budget."""
