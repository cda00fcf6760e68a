"""What runs on the host: the driver, progress, checkpoints, and many runs side by side."""
