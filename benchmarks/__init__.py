"""Our times against C of the same algorithms: ``python -m benchmarks [--quick] [--only NAME]``."""
