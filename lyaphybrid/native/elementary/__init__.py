"""Arithmetic of single entries, and elementary functions as inline instructions."""
