"""The interface between compiled programs and JAX."""
