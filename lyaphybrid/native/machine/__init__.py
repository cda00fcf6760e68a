"""Machine code: LLVM, the cache on disk, and tiered compilation."""
