"""Random Hamiltonians of two degrees of freedom: pairs of exponents, symplectic derivatives, energy, two methods.

H = p·Mp/2 + q·Kq/2 + c (q₁²q₂ − q₂³/3) + d |q|⁴/4, with M and K positive definite; every third one is linear, and the
exponential of its matrix is the truth.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

import lyaphybrid as lh

from .batches import in_batches, judged

LENGTH, STEP = 5.0, 0.05
SYSTEM = lh.Hamiltonian(
    lambda p, args: 0.5 * p @ args["M"] @ p,
    lambda q, args: (
        0.5 * q @ args["K"] @ q + args["c"] * (q[0] ** 2 * q[1] - q[1] ** 3 / 3) + 0.25 * args["d"] * jnp.sum(q**2) ** 2
    ),
)
METHODS = {"symplectic": lh.Symplectic(dt=STEP), "adaptive": lh.RungeKutta(rtol=1e-11, atol=1e-13)}
J = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])


def case(seed: int) -> dict:
    """Parameters and a start of moderate energy."""
    draw = np.random.default_rng(seed)

    def definite():
        turn = np.linalg.qr(draw.normal(size=(2, 2)))[0]
        return turn @ np.diag(draw.uniform(0.3, 2.0, 2)) @ turn.T

    linear = seed % 3 == 0
    args = {"M": definite(), "K": definite(), "c": 0.0 if linear else draw.uniform(0, 0.5)}
    args["d"] = 0.0 if linear else draw.uniform(0.3, 1.0)  # so large that the motion is bounded
    return {"args": (args, draw.uniform(-0.7, 0.7, 4)), "linear": linear}


@functools.partial(jax.jit, static_argnums=0)
def _motions(name: str, batch):
    def one(given):
        args, x0 = given
        where = {"t1": LENGTH, "method": METHODS[name], "throw": False}
        s = lh.lyapunov_spectrum(SYSTEM, x0, args, blocks=2, **where)
        m = lh.tangent_map(SYSTEM, x0, args, **where)
        change = SYSTEM.energy(m.x, args) - SYSTEM.energy(x0, args)
        return s.exponents * LENGTH, s.status_code, m.matrix, m.x, change

    return jax.lax.map(one, batch)


def failures(seeds) -> dict[int, str]:
    """What is wrong, by seed."""
    cases = {seed: case(seed) for seed in seeds}
    runs = {name: in_batches(functools.partial(_motions, name), cases) for name in METHODS}
    found = {}
    for (seed, known, stepped), (_, _, free) in zip(*runs.values(), strict=True):
        growth, status, matrix, x, change = stepped
        size = np.linalg.norm(matrix, 2) ** 2
        off = [float(np.max(np.abs(m.T @ J @ m - J))) for m in (matrix, free[2])]
        found |= judged(
            seed,
            status=status == free[1] == lh.STATUS.ok,
            pairs=np.max(np.abs(growth + growth[::-1])) < 1e-11,
            symplectic=off[0] < 1e-12 * size and off[1] < 1e-8 * size,
            energy=abs(change) < 1e-6 and abs(free[4]) < 1e-9,
            methods=np.max(np.abs(x - free[3])) < 1e-5 and np.linalg.norm(matrix - free[2]) < 1e-4 * np.sqrt(size),
            linear=not known["linear"] or _is_exponential(known["args"][0], free[2]),
        )
    return found


def _is_exponential(args: dict, matrix) -> bool:
    zero = np.zeros((2, 2))
    known = scipy.linalg.expm(LENGTH * np.block([[zero, args["M"]], [-args["K"], zero]]))
    return bool(np.max(np.abs(matrix - known)) < 1e-8 * np.max(np.abs(known)))
