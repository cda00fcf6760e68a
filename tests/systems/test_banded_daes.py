"""DAEs with banded constraints: factors against dense inverses, a grid of 220 components against sparse LU."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._jax.engines import compiled
from lyaphybrid._linalg.banded import factorised, probes, solve
from lyaphybrid.papers.linh.beyond.power_grids import Grid
from lyaphybrid.systems.daes.bands import places_away


@compiled()
def solved(seen, right):
    factors, sign = factorised(seen)
    return solve(factors, right), sign


@pytest.mark.parametrize(("m", "b"), [(1, 1), (5, 2), (7, 1), (20, 3)])
def test_factors(m, b):
    """Lengths that blocks fit and do not fit; a right-hand side and several."""
    rng = np.random.default_rng(m)
    distance = np.abs(np.subtract.outer(np.arange(m), np.arange(m)))
    matrix = rng.standard_normal((m, m)) * (distance <= b) - 2 * b * np.eye(m)
    seen = matrix @ probes(m, b)
    for right in (rng.standard_normal(m), rng.standard_normal((m, 3))):
        found, sign = solved(seen, right)
        assert_allclose(found, np.linalg.solve(matrix, right), atol=1e-13)
        assert sign == np.sign(np.linalg.det(matrix))


def test_the_velocity_is_the_same():
    """Away from rest: x' by banded factors, and by full inverses."""
    grid = Grid(8, every=6)
    x, change = jnp.asarray(grid.rest + 0.1 * np.sin(np.arange(grid.n))), jnp.cos(jnp.arange(1.0 * grid.n))

    def of(bandwidth):
        field = grid.dae(bandwidth).field
        return compiled()(lambda t, x, dx: (field(t, x, None), field.onto(t, x, None, dx)))(jnp.zeros(()), x, change)

    (slow, onto), (fast, banded_onto) = of(None), of(3)
    assert_allclose(fast, slow, atol=1e-12)
    assert_allclose(banded_onto, onto, atol=1e-12)


@pytest.mark.slow
def test_banded_is_dense():
    """A small grid, moved out of its rest: the same motion and exponents as with full inverses."""
    grid = Grid(6, every=6)
    found = []
    for bandwidth in (None, 3):
        dae = grid.dae(bandwidth)
        start = lh.consistent_start(dae, np.concatenate([grid.rest[:3] + [0.3, -0.2, 0.1], grid.rest[3:]]))
        s = lh.lyapunov_spectrum(dae, start, t1=5.0, k=2, method=lh.HalfExplicit(1e-7), blocks=2)
        found.append(np.concatenate([s.x, s.exponents]))
    assert_allclose(found[1], found[0], atol=1e-11)


@pytest.mark.slow
def test_a_grid_of_220_components():
    """All forty exponents at a finite time against the matrix exponential; at rest their sum is a trace."""
    grid = Grid(60)
    assert (grid.n, grid.d) == (220, 40)
    dae = grid.dae(3)
    start = lh.consistent_start(dae, grid.rest)
    assert_allclose(start, grid.rest, atol=1e-9)
    exact, trace = grid.log_growth(6.0), np.trace(grid.reduced(grid.rest)[1])
    found = lh.svd_spectrum(dae, start, t1=6.0, blocks=2, method=lh.HalfExplicit(1e-8))
    print(np.max(np.abs(found.log_values[-1] - exact)))
    assert found.status is lh.STATUS.ok
    assert_allclose(found.log_values[-1], exact, atol=1e-6)
    assert_allclose(found.exponents.sum(), trace, atol=1e-7)


@pytest.mark.slow
def test_bad_arguments():
    grid = Grid(4, every=6)
    for bad in (0, 1.5, True):
        with pytest.raises(ValueError, match="bandwidth must be at least 1"):
            grid.dae(bad)
    with pytest.raises(ValueError, match="depends on the algebraic component 3 places away"):
        lh.trajectory(grid.dae(2), jnp.asarray(grid.rest), t1=1.0, n=1)


def late(t, x, c):
    """A coupling two places away that begins where y0 > 1, which is not so at the start."""
    y, z = x[:6], x[6:]
    far = c * jnp.maximum(y[0] - 1.0, 0.0) ** 2 * jnp.concatenate([z[2:], jnp.zeros(2)])
    driven = 3 * jnp.tanh(jnp.roll(z, -1)) - 2 * jnp.tanh(jnp.roll(z, 3)) + 2 * jnp.cos(t)
    return jnp.concatenate([driven - y, z + far + 0.3 * z**3 - y])


@pytest.mark.slow
def test_a_coupling_that_begins_later():
    """It was dropped from Newton's matrix and from tangents: λ₁ = −0.0144 for c = 0.1 instead of 0.0011."""
    leading = np.diag((np.arange(12) < 6).astype(float))
    start = np.concatenate([np.linspace(-1.0, 0.5, 6), np.zeros(6)])

    def of(bandwidth):
        return lh.DAE(lambda t, args: jnp.asarray(leading), late, 6, bandwidth=bandwidth)

    point = lh.consistent_start(of(2), start, 0.1)
    with pytest.raises(ValueError, match="depends on the algebraic component 2 places away, here or at other states"):
        lh.trajectory(of(1), point, 0.1, t1=1.0, n=1)
    assert not lh.check(of(1), point, 0.1).ok
    assert lh.trajectory(of(1), point, 0.0, t1=0.1, n=1).status is lh.STATUS.ok
    assert lh.trajectory(of(2), point, 0.1, t1=0.1, n=1).status is lh.STATUS.ok


@pytest.mark.slow
@pytest.mark.parametrize("inner", [0.0, 0.7])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_constraints_that_move_and_rows_with_algebraic_components(count, inner):
    """(x + c y₀)' = −x + Σ y with A y = v x + (sin t, 0, …): λ = (−1 + 1ᵀA⁻¹v)/(1 + c (A⁻¹v)₀)."""
    leading = np.zeros((count + 1, count + 1))
    leading[0, :2] = 1.0, inner
    matrix = 2 * np.eye(count) + 0.3 * np.eye(count, k=1) + 0.2 * np.eye(count, k=-1)
    weights, push = np.linspace(0.2, 0.5, count), np.eye(count)[0]

    def residual(t, x, args):
        return jnp.concatenate([jnp.sum(x[1:])[None] - x[:1], matrix @ x[1:] - weights * x[0] - push * jnp.sin(t)])

    found, y = [], np.linalg.solve(matrix, weights)
    for bandwidth in (None, 1):
        dae = lh.DAE(lambda t, args: jnp.asarray(leading), residual, 1, bandwidth=bandwidth)
        start = lh.consistent_start(dae, np.ones(count + 1))
        found.append(lh.lyapunov_spectrum(dae, start, t1=5.0))
    assert_allclose(found[1].exponents, (y.sum() - 1) / (1 + inner * y[0]), rtol=1e-8)
    assert_allclose(found[1].x, found[0].x, rtol=1e-12)


M = 6
NEXT = np.minimum(np.arange(M) + 1, M - 1)
SPARSE = np.diag(np.ones(M - 1), 1) + 2 * np.eye(M)


def product_in_a_loop(t, z, a):
    return z + jax.lax.fori_loop(0, M - 1, lambda i, found: found.at[i].set(z[i] * z[i + 1]), jnp.zeros(M))


# Constraints by name: how many places away from the diagonal they reach, and the function of (t, z, a), a = SPARSE.
REACHING = {
    "a constant matrix": (1, lambda t, z, a: SPARSE @ z),
    "a matrix with rounding": (1, lambda t, z, a: (SPARSE + 1e-17) @ z),
    "a matrix among args": (1, lambda t, z, a: jnp.einsum("ij,j,i->i", a, jnp.sin(z), z)),
    "a matrix that depends on the state": (1, lambda t, z, a: z + jnp.diag(jnp.sin(z[:-1]), 1) @ z),
    "a mask": (1, lambda t, z, a: z + np.sign(M - 1.0 - np.arange(M)) * jnp.sin(jnp.roll(z, -1))),
    "a choice": (1, lambda t, z, a: z + jnp.where(jnp.arange(M) == 0, jnp.roll(z, -1), 0.0)),
    "pairs": (1, lambda t, z, a: z + jnp.sum(a * jnp.sin(z[None] - z[:, None]), axis=1)),
    "pairs that are chosen": (1, lambda t, z, a: z + jnp.sum(jnp.where(a != 0, jnp.sin(z[None] - z[:, None]), 0), 1)),
    "indices": (1, lambda t, z, a: z[NEXT] * z),
    "sums into entries": (1, lambda t, z, a: z + jnp.zeros(M).at[NEXT].add(z)),
    "lanes": (1, lambda t, z, a: jax.vmap(lambda u, v: jax.nn.relu(u) * v)(z, z[NEXT])),
    "a convolution": (1, lambda t, z, a: jnp.convolve(z, jnp.array([1.0, 2.0, 1.0]), mode="same")),
    "branches": (1, lambda t, z, a: jax.lax.cond(t > 9, lambda z: z[NEXT], lambda z: z, z)),
    "a loop": (1, product_in_a_loop),
    "sums that cancel": (0, lambda t, z, a: z + jnp.diff(jnp.cumsum(jnp.concatenate([z[:1], z])))),
    "no derivative": (0, lambda t, z, a: z + jax.lax.stop_gradient(jnp.sum(z))),
    "a ring": (M - 1, lambda t, z, a: z + jnp.roll(z, 1)),
    "far states only": (M - 1, lambda t, z, a: z + jnp.maximum(jnp.sum(z) - 1e4, 0) ** 2),
    "an index that moves": (M - 1, lambda t, z, a: z + z[jnp.floor(3 * jnp.sin(t) + 3).astype(int)]),
    "a solver": (M - 1, lambda t, z, a: jnp.linalg.solve(2 * jnp.eye(M) + jnp.outer(z, z), z)),
}


@pytest.mark.slow_cases(all_but=("a matrix among args", "a mask", "indices", "far states only", "a loop"))
@pytest.mark.parametrize("name", REACHING)
def test_how_far_constraints_reach(name):
    """Neither more, which would refuse what is banded, nor less."""
    away, constraint = REACHING[name]
    leading = np.diag((np.arange(M + 1) < 1).astype(float))

    def residual(t, x, args):
        return jnp.concatenate([x[:1], constraint(t, x[1:], args)])

    field = lh.DAE(lambda t, args: jnp.asarray(leading), residual, 1, bandwidth=1).field
    found = jax.jit(lambda x, a: places_away(field, jnp.zeros(()), x, a))(jnp.linspace(0.1, 0.7, M + 1), SPARSE)
    assert found == away
