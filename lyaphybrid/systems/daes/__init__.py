"""Differential-algebraic equations that are semi-linear, and how their algebraic equations are eliminated."""
