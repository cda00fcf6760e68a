"""Compiled programs as JAX sees them."""
