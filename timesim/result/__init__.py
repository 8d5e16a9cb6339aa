"""What stays on disk: records, NetCDF files, run folders, labels and units, states taken up again, checkpoints."""
