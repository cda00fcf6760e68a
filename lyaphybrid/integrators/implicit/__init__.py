"""Implicit and half-explicit methods, for DAEs and stiff flows."""
