"""LLVM, the cache on disk, and the tiers of code."""
