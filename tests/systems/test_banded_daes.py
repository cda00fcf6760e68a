"""DAEs with banded constraints: factors against dense inverses, a grid of 220 components against sparse LU."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._jax.engines import compiled
from lyaphybrid._linalg.banded import factorised, probes, solve
from lyaphybrid.papers.linh.beyond.power_grids import Grid


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


def test_bad_arguments():
    grid = Grid(4, every=6)
    for bad in (0, 1.5, True):
        with pytest.raises(ValueError, match="bandwidth must be at least 1"):
            grid.dae(bad)
    with pytest.raises(ValueError, match="depends on the algebraic component 3 places away"):
        lh.trajectory(grid.dae(2), jnp.asarray(grid.rest), t1=1.0, n=1)
