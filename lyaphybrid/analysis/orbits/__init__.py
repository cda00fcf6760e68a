"""Periodic orbits: shooting, multipliers, families, symmetries."""
