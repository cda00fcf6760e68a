"""Flows that are fast for a while: what their saltation matrices stretch and shrink is known in closed form.

V' = 1 up to 1, then V' = F up to 2, then V⁺ = 0; w' = −pw while it is slow, and w⁺ = cw + 1. The two jumps, of
|f⁺|/|f⁻| = F and 1/F, and what lies between are together (δV, δw)⁺ = (δV, cδw − pδV), up to 1/F.
"""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid._jax.magnitudes import UNKNOWN_MAGNITUDE, absolute
from lyaphybrid._linalg import frames

TURNS = 20

SYSTEM = lh.Hybrid(
    {
        "slow": lambda t, x, args: jnp.stack([jnp.ones_like(x[0]), -args["p"] * x[1]]),
        "fast": lambda t, x, args: jnp.stack([args["F"] * jnp.ones_like(x[0]), jnp.zeros_like(x[1])]),
    },
    [
        lh.Transition(lambda t, x, args: 1.0 - x[0], source="slow", target="fast"),
        lh.Transition(
            lambda t, x, args: 2.0 - x[0],
            lambda t, x, args: jnp.stack([jnp.zeros_like(x[0]), args["c"] * x[1] + 1.0]),
            source="fast",
            target="slow",
        ),
    ],
)


def spectrum(p, c, F, x0=(0.25, 0.3), **keywords):
    args = {"p": p, "c": c, "F": F}
    return lh.lyapunov_spectrum(SYSTEM, jnp.array(x0), args, t1=float(TURNS), mode="slow", throw=False, **keywords)


def closed_form(p, c):
    """Exponents of TURNS turns, from V = 1/4 to V = 1/4, of the columns (1, 0) and (0, 1)."""
    w = 0.0
    for turn in range(TURNS):
        w = c * np.exp(-p * (0.75 if turn == 0 else 1.0)) * w - p
    first = 0.5 * np.log1p((w * np.exp(-p / 4)) ** 2) / TURNS
    return np.array([first, -p + np.log(c) - first if c else -np.inf])


@pytest.mark.slow_cases("1.0-100000000.0", "1.0-100000000000.0", "1.0-100000000000000.0")
@pytest.mark.parametrize(
    ("factor", "speed"),
    [
        *((factor, speed) for factor in (1.0, 0.0) for speed in (1e8, 1e11, 1e14, 1e20, 1e40)),
        (1e-14, 1e8),
        (1e-14, 1e11),
    ],
)
def test_a_stretch_that_is_undone_is_no_loss_and_a_loss_within_it_is_one(factor, speed):
    found = spectrum(0.5, factor, speed)
    np.testing.assert_allclose(found.exponents, closed_form(0.5, factor), rtol=0, atol=1e-8)
    assert found.losses.tolist() == [0, 0 if factor else TURNS]
    assert found.notes == (frozenset() if factor else {"rank_lost"})
    assert int(found.jumps) == 2 * TURNS


@pytest.mark.slow
def test_one_column_side_by_side_and_in_a_sweep():
    wanted = closed_form(0.5, 1.0)
    args = {"p": 0.5, "c": 1.0, "F": 1e14}
    several = spectrum(0.5, 1.0, 1e14, x0=[[0.25, 0.3], [0.25, 0.9]]).replicates
    lanes = jax.vmap(lambda speed: spectrum(0.5, 1.0, speed).exponents)(jnp.array([1e12, 1e14]))
    swept = lh.sweep(lambda args: spectrum(**args), {"F": np.array([1e12, 1e14])}, args=args, progress=False)
    for found in (several, lanes, swept.exponents.values):
        np.testing.assert_allclose(found, [wanted, wanted], atol=1e-9)
    np.testing.assert_allclose(spectrum(0.5, 1.0, 1e14, frame=np.eye(2)[:, :1]).exponents, wanted[:1], atol=1e-9)


def exponents(p):
    return spectrum(p, 1.0, 1e14).exponents


STEP = 1e-5
SLOPE = (closed_form(0.5 + STEP, 1.0) - closed_form(0.5 - STEP, 1.0)) / (2 * STEP)


@pytest.mark.slow
def test_forward_derivatives_pass_a_stretch():
    np.testing.assert_allclose(jax.jacfwd(exponents)(jnp.array(0.5)), SLOPE, rtol=1e-6)


@pytest.mark.slow
def test_reverse_derivatives_pass_a_stretch():
    np.testing.assert_allclose(jax.jacrev(exponents)(jnp.array(0.5)), SLOPE, rtol=1e-6)


# Columns judged by the terms of their entries.


@pytest.mark.parametrize("kind", frames.QR_ALGORITHMS)
def test_a_small_row_keeps_a_column_that_differs_there_alone(kind):
    """Rows of sizes 1 and 1e-20, known to rounding each: the columns are independent. Known to 1e-12 they are not."""
    frame = jnp.array([[3.0, 2.0], [4e-20, -1e-20]])
    length = 11e-20 / 3  # det / |first|

    def found(sizes):
        return frames.orthonormalise_after_jump(frame, kind, frames.LOST, sizes)[0]

    columns, log_r, lost = found(jnp.abs(frame))
    assert not np.any(lost)
    np.testing.assert_allclose(log_r, np.log([3.0, length]), rtol=1e-14)
    np.testing.assert_allclose(columns.T @ columns, np.eye(2), atol=1e-15)
    assert found(jnp.ones((2, 2)))[2].tolist() == [False, True]
    assert frames.orthonormalise(frame, kind, frames.LOST, frames.LOST)[2].tolist() == [False, True]


@pytest.mark.slow_cases("5", "20")
@pytest.mark.parametrize("k", [3, 5, 20])
def test_one_small_row_among_many_columns(k):
    """Square frames, whose last column differs from the others' span in the small row alone: against 200 digits."""
    frame = np.random.default_rng(7).standard_normal((k, k))
    frame[k // 2] *= 1e-40
    terms = jnp.abs(frame)
    (columns, log_r, lost), doubtful = frames.orthonormalise_after_jump(jnp.asarray(frame), "mgs", frames.LOST, terms)
    assert not doubtful
    assert not np.any(lost)
    with mpmath.workdps(200):
        _, r = mpmath.qr(mpmath.matrix(frame.tolist()))
        wanted = [float(mpmath.log(abs(r[i, i]))) for i in range(k)]
    np.testing.assert_allclose(log_r, wanted, atol=1e-11)
    np.testing.assert_allclose(columns.T @ columns, np.eye(k), atol=1e-14)
    frame[k // 2] = 0.0
    (_, _, lost), _ = frames.orthonormalise_after_jump(jnp.asarray(frame), "mgs", frames.LOST, jnp.abs(frame))
    assert lost.tolist() == [False] * (k - 1) + [True]


@pytest.mark.slow
def test_magnitudes_of_a_linear_function():
    matrix = np.array([[1.0, -2.0, 0.0], [0.0, 3.0, -1e-30], [-4.0, 4.0, 0.5]])
    x = jnp.array([1.0, 10.0, 100.0])

    def product(dx):
        return jnp.asarray(matrix) @ dx

    def by_parts(dx):
        a, b, c = dx
        scaled = jax.lax.cond(x[0] > 0, lambda b: -2 * b, lambda b: b, b)
        return jnp.stack([a + scaled, 3 * b - c / 1e30, jnp.where(x[1] > 0, 4 * (b - a), 0.0) + c * 0.5])

    def reset(dx):
        return jax.jvp(jax.jit(lambda x: jnp.sin(x) * jnp.array([1.0, -1.0, 0.0])), (x,), (dx,))[1]

    np.testing.assert_allclose(absolute(product)(x), np.abs(matrix) @ x)
    np.testing.assert_allclose(absolute(by_parts)(x), np.abs(matrix) @ x)
    np.testing.assert_allclose(absolute(reset)(x), np.abs(np.cos(x)) * x * np.array([1.0, 1.0, 0.0]))
    # What cancels within is seen: (dx + 1e9 dx) − 1e9 dx has terms of 1e9.
    np.testing.assert_allclose(absolute(lambda dx: (dx + 1e9 * dx) - 1e9 * dx)(x), (2e9 + 1) * x)
    assert np.all(absolute(lambda dx: jnp.linalg.solve(jnp.asarray(matrix), dx))(x) == UNKNOWN_MAGNITUDE)
