"""How work in chunks is carried out: campaigns with checkpoints, and their workers, threads, processes or a cluster."""
