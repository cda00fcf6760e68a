"""Linh and others, semi-linear DAEs: its checks, figures and report."""
