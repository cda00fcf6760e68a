"""JAX tooling that knows nothing of dynamics: tracing, jaxprs, hashes, and the engine that runs large functions."""
