"""Many equal systems as one, and noise that is the same for all."""
