"""Splitting methods of Hamiltonian systems, and their tangent maps."""
