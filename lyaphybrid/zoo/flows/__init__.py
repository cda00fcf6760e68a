"""Smooth flows and DAEs."""
