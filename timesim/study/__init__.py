"""What each `study.kind` runs, and how: in one go, or in chunks on threads, processes or a cluster."""
