"""Independent evidence where we contradict Skokos & Gerlach: a C program written from the equations.

Its numbers are in `tests/data/tangent_dynamics.json`.
"""

__all__ = ["SYMPLECTIC", "WITNESS", "constant", "listed", "witnessed"]

# Exponents of R1, C1 and C2, and GALI_2 of R3, at τ = 0.05, by orbit, method and time.
WITNESS = {
    ("R1", "TM", 1e8): (1.5268e-07, 1.5287e-07, -1.4013e-07, -1.6542e-07),
    ("R1", "TDHcc", 1e7): (1.54544e-03, 6.3247e-07, -4.8863e-07, -1.54559e-03),
    ("R1", "TDHeps", 1e7): (7.7653e-05, 2.9905e-05, -2.9772e-05, -7.7786e-05),
    ("C1", "DOP853", 1e7): (4.42889e-02, 1.3399e-06, -1.2273e-06, -4.42890e-02),
    ("C2", "TM", 1e5): (3.0507e-04, 8.6860e-05),
    ("C2", "DOP853", 1e5): (3.6962e-04, 8.6877e-05),
    ("C2", "TDHcc", 1e5): (6.2440e-05, 5.6394e-05),
    ("C2", "TDHeps", 1e5): (2.4240e-04, 1.2523e-04),
    ("C2", "TM", 1e8): (1.1968e-04, 1.5428e-07, -1.4663e-07, -1.1969e-04),
    ("R3", "TDHeps", 1e6): (0.97794,),
    ("R3", "TM", 1e6): (0.12724,),
}

SYMPLECTIC = (
    "the tangent of each step is symplectic, by TDHcc, TDHes and TDHeps as well (by DOP853 up to its error), so that "
    "a sum is at most a constant over t; the C program has t |λ1 + λ4| = "
)


def listed(values, form: str = ".2e") -> str:
    """Formatted numbers."""
    return ", ".join(f"{float(value):{form}}".replace("-", "−") for value in values)


def witnessed(orbit: str, method: str, t: float, *which: int) -> str:
    """The C program's numbers for an orbit by a method at t: the first, or those with the given indices."""
    return listed([WITNESS[orbit, method, t][i] for i in which or (0,)])


def constant(orbit: str, method: str, t: float) -> str:
    """The C program's t |λ₁ + λ_2N|."""
    first, *_, last = WITNESS[orbit, method, t]
    return f"{t * abs(first + last):.2g} at t = {t:.0e} ({orbit}, {method})"
