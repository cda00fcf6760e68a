"""Code that runs on the host: the driver, progress, checkpoints, and batches of runs."""
