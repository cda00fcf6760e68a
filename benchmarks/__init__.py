"""Our times against hand-written C of the same algorithms: ``python -m benchmarks [--quick] [--only NAME] [--json]``."""
