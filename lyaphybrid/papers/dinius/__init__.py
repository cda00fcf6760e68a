"""Dinius, Lyapunov exponents of hybrid systems and hard disks: its checks, figures and report."""
