"""Skokos & Gerlach, tangent maps of Hamiltonian systems: its checks, figures and report."""
