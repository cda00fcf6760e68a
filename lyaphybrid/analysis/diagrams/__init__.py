"""Sections, stroboscopic points and bifurcation diagrams."""
