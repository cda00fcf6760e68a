"""Circuits, neurons and piecewise systems."""
