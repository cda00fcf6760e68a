"""Arithmetic of single entries, and the elementary functions written out."""
