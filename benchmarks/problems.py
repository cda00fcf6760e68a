"""The numbers of the benchmark problems: what both sides, ours and the C, compute."""

import numpy as np

LORENZ_PARAMETERS = (10.0, 28.0, 8 / 3)  # sigma, rho, beta
LORENZ_START = (1.0, 1.0, 1.0)
LORENZ_DT = 0.01

# H = (px² + py²)/2 + (x² + y²)/2 + x²y − y³/3 = 1/8: the orbit C1 of Skokos and Gerlach, in the big chaotic sea
HENON_HEILES_START = (0.0, -0.016, 0.49974120235711333, 0.0)
HENON_HEILES_DT = 0.05

# x'' + 2 zeta x' + x = cos(omega t), x <= 0; at the wall v -> -restitution v
IMPACT_PARAMETERS = {"zeta": 0.05, "omega": 2.8, "restitution": 0.8}
IMPACT_START = (0.0, -0.5)
IMPACT_DT = 0.01
IMPACT_RTOL = 1e-9
IMPACT_ATOL = 1e-12
IMPACT_EVERY = 10  # accepted steps; the C counts them with error control too, …
IMPACT_EVERY_TIME = 0.25  # … ours goes by time there: ten of its steps
IMPACT_EVERY_EVENT = 10.0  # against diffrax: at events alone, this long after the last one at the latest

# theta'' + beta theta' + stiffness sin(theta) + alpha sgn(theta') = amplitude sin(omega t)
FRICTION_PARAMETERS = {"beta": 0.052, "alpha": 0.01, "stiffness": 0.87, "amplitude": 0.586, "omega": 0.666}
FRICTION_PERIOD = 2 * np.pi / FRICTION_PARAMETERS["omega"]
FRICTION_START = (0.3, 0.5)
FRICTION_DT = 0.02
FRICTION_RTOL = 1e-9
FRICTION_ATOL = 1e-12
FRICTION_EVERY = 10  # as for the impacts
FRICTION_EVERY_TIME = 0.3

# Four disks of diameter and mass 1, kinetic energy 4, total momentum 0, number density 0.7, L_x / L_y = √3/2:
# (q_0x, q_0y, …, q_3y, p_0x, …, p_3y)
DISKS_BOX = (2.2245711031688638, 2.5687134504920124)
DISKS_EVERY = 10  # collisions
DISKS_START = (
    *(0.27807138789610797, 0.32108918131150155, 0.27807138789610797, 1.6054459065575077),
    *(1.3903569394805397, 0.9632675439345046, 1.3903569394805397, 2.247624269180511),
    *(1.474617456934273, 0.49153915231142425, -0.8192319205190405, 1.3107710728304647),
    *(-1.1469246887266566, -0.9830783046228485, 0.49153915231142425, -0.8192319205190405),
)

# Example 5.1 of Linh, Truong & Tuyen, doi:10.52825/dae-p.v3i.2632; the columns lie in the tangent space at the start
SPRING_PARAMETERS = {"stiffness": 1.0, "cubic": 1.0, "damping": 2.0, "radius": 2.0, "mass": 1.0, "inertia": 4.0}
SPRING_START = (1.0, 1.0, 0.5, 0.0)
SPRING_COLUMNS = ((1.0, 0.0), (0.0, 1.0), (0.0, 0.5), (2.0, -1.0))
SPRING_TOL = 1e-6
SPRING_T1 = (1000.0, 10_000.0)  # of the tables in the paper
SPRING_DAMPINGS = (1.5, 2.5)  # of the sweep, the first and the last
SPRING_SWEEP_T1 = 100.0


# Sweeps: the parameter, its first and last value (no lane ends early), and how long each lane is
LORENZ_SWEEP, LORENZ_SWEEP_STEPS = ("rho", 26.0, 30.0), 20_000
HENON_HEILES_SWEEP, HENON_HEILES_SWEEP_STEPS = ("y", -0.02, -0.012), 20_000  # of the start
IMPACT_SWEEP, FRICTION_SWEEP, OSCILLATORS_SWEEP_T1 = ("restitution", 0.79, 0.81), ("beta", 0.05, 0.054), 500.0


def paired_frame(n: int) -> np.ndarray:
    """The frame (2n, 2n) with columns e_q1 … e_qn, e_pn … e_p1 that Hamiltonian systems start from."""
    identity = np.eye(2 * n)
    return np.concatenate([identity[:, :n], identity[:, : n - 1 : -1]], axis=1)
