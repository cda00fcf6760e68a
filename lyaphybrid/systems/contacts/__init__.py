"""Surfaces where a field is discontinuous, Filippov systems, and rigid bodies in contact."""
