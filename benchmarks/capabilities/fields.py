"""Fields of finite-time exponents and of angles between directions, through jumps, against closed forms."""

import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, off

TITLE = "Fields of local exponents and directions through jumps"
PRECISE = lh.RungeKutta("dop853", rtol=1e-12, atol=1e-14)
BALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -args * x[1]])),
)
PENDULUM = lh.Flow(lambda t, x, args: jnp.stack([x[1], -jnp.sin(x[0])]))
KEPT, UP = 0.5, 0.3  # of y at a jump


def bounced(height: float, speed: float, r: float, t: float) -> np.ndarray:
    """The matrix of a ball after its only bounce."""
    hit = np.sqrt(speed**2 + 2 * height)
    d_hit = np.array([1.0, speed]) / hit
    d_meets, left = d_hit + np.array([0.0, 1.0]), t - hit - speed
    return np.stack([r * d_hit * left - r * hit * d_meets + left * d_meets, r * d_hit + d_meets])


def bouncing_ball(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.ftle_field(BALL, [[0.3, -0.3], [0.6, 0.5]], 0.8, t1=1.7, shape=(4, 5)))
    heights, speeds = found.axes.values()
    sizes = [[np.linalg.svd(bounced(h, v, 0.8, 1.7))[1] for v in speeds] for h in heights]
    truth = "closed form, singular values of its matrix"
    return Row(
        "finite-time exponents of a ball after a bounce", truth, apart(found.exponents, np.log(sizes) / 1.7), 1e-9
    )


def blow_up(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.ftle_field(lh.Flow(lambda t, x, args: x**2), [[-1.0], [0.4]], t1=2.0, shape=(50,)))
    exact = -np.log(1 - 2 * found.axes[0])
    return Row("finite-time exponents of x' = x²", "closed form", apart(found.exponents[:, 0], exact), 1e-9)


def separatrix(clock: Stopwatch) -> Row:
    shape = (90, 60)
    found = clock(lambda: lh.ftle_field(PENDULUM, [[-3.0, 0.5], [0.0, 2.5]], t1=14.0, shape=shape))
    theta, omega = found.ridges(sharpest=0.05).T
    cells = np.abs(omega - np.sqrt(2 + 2 * np.cos(theta))) * shape[1] / 2.0
    truth = "closed form, the separatrix ω² = 2 + 2 cos θ"
    return Row("the sharpest ridges of a pendulum", truth, float(np.max(cells)), 0.5, "cells")


def to_and_fro() -> lh.Hybrid:
    """x' = x, y' = −1.5 y, and at x = 1 back to x = 0.2 with y⁺ = y/2 + 0.3."""
    return lh.Hybrid(
        lambda t, x, args: jnp.stack([x[0], -1.5 * x[1]]),
        lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: jnp.stack([0.2 * x[0], KEPT * x[1] + UP])),
    )


def angles_of_a_hybrid_flow(clock: Stopwatch) -> Row:
    how = {"shape": (3, 2), "transient": 18.0, "method": PRECISE}
    found = clock(lambda: lh.angle_field(to_and_fro(), [[0.3, 0.1], [0.9, 1.3]], **how))
    x, y = np.moveaxis(found.where, -1, 0)
    truth = "closed form, the flow against what contracts"
    return Row(
        "angles between covariant vectors through jumps", truth, apart(found.angles, np.arctan2(x, 1.5 * y)), 1e-9
    )


def angles_at_starts(clock: Stopwatch) -> Row:
    back = lh.Hybrid(
        lambda t, x, args: jnp.stack([-x[0], 1.5 * x[1]]),
        lh.Transition(lambda t, x, args: x[0] - 0.2, lambda t, x, args: jnp.stack([5 * x[0], (x[1] - UP) / KEPT])),
    )
    how = {"shape": (3, 2), "transient": 18.0, "method": PRECISE, "inverse": back}
    found = clock(lambda: lh.angle_field(to_and_fro(), [[0.3, 0.1], [0.9, 1.3]], **how))
    x, after_jump = found.axes[0][:, None], UP / (1 - KEPT * 5**-1.5)
    exact = np.arctan2(x, 1.5 * after_jump * (x / 0.2) ** -1.5)
    truth = "closed form, on the attractor above each start"
    return Row("the same at the starts, by the inverse system", truth, apart(found.angles, exact), 1e-8)


def cat_map(clock: Stopwatch) -> Row:
    matrix = np.array([[3.0, 2.0], [1.0, 1.0]])
    cat = lh.Map(lambda n, x, args: (matrix @ x) % 1.0)
    found = clock(lambda: lh.angle_field(cat, [[0.0, 0.0], [1.0, 1.0]], shape=(3, 4), transient=20))
    vectors = np.linalg.eig(matrix)[1]
    exact = np.arccos(abs(vectors[:, 0] @ vectors[:, 1]))
    return Row("angles of a cat map", "closed form, its eigenvectors", off(found.angles, exact), 1e-12, "relative")


ROWS = (bouncing_ball, blow_up, separatrix, angles_of_a_hybrid_flow, angles_at_starts, cat_map)
