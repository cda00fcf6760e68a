"""Hamiltonian systems."""
