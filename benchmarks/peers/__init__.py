"""Our times against those of other programs, on the same work at the same error: ``python -m benchmarks.peers``."""
