"""All exponents of stiff flows by implicit methods in the continuous QR method.

They are compared with explicit steps and discrete QR, another method for both tangents and growth, at tight tolerances:
`REFERENCES`, which a slow test computes again. The sum of all is the mean divergence along a path by LSODA in SciPy.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid.integrators.implicit.orthonormal_stages import StageMatrices, solved_columns


def van_der_pol(t, x, args, xp=jnp):
    return xp.stack([x[1], 1000.0 * (1 - x[0] ** 2) * x[1] - x[0]])


def oregonator(t, x, args, xp=jnp):
    """R. J. Field & R. M. Noyes, J. Chem. Phys. 60 (1974) 1877, doi:10.1063/1.1681288."""
    a, b, c = x
    return xp.stack([77.27 * (b - a * b + a - 8.375e-6 * a**2), (c - b - a * b) / 77.27, 0.161 * (a - c)])


def robertson(t, x, args, xp=jnp):
    """E. Hairer & G. Wanner, Solving ODEs II (1996), (IV.1.4), doi:10.1007/978-3-642-05221-7."""
    slow, fast = 0.04 * x[0] - 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
    return xp.stack([-slow, slow - fast, fast])


FLOWS = {  # field, start, length
    "van der Pol": (van_der_pol, [2.0, 0.0], 3000.0),
    "Oregonator": (oregonator, [1.0, 2.0, 3.0], 320.0),
    "Robertson": (robertson, [1.0, 0.0, 0.0], 100.0),
}
REFERENCES = {  # by lh.RungeKutta(rtol=1e-12, atol=1e-14); at 1e-10 they differ by less than 1e-12 of the largest
    "van der Pol": [0.0001898692020896765, -1863.7421085380563],
    "Oregonator": [-0.01858860804637914, -0.47459245039939046, -23346.37514770937],
    "Robertson": [-0.0026655871033633466, -0.03294816455017499, -3447.4556041177025],
}


def spectrum(name, method, **options):
    field, start, length = FLOWS[name]
    return lh.lyapunov_spectrum(lh.Flow(field), start, t1=length, blocks=2, method=method, **options)


@pytest.mark.slow_cases("3")
@pytest.mark.parametrize("together", [1, 3])
def test_columns_one_after_the_other_solve_the_stages_of_all(together):
    """C_i − Σ_l w_il C_l' = base_i, with C' = A C − C B written for all columns, by SciPy from the same guess."""
    draw = np.random.default_rng(5)
    matrices, weights = draw.normal(size=(together, 3, 3)), 0.1 * draw.normal(size=(together, together))
    base = np.linalg.qr(draw.normal(size=(together, 3, 3)))[0]
    stages = StageMatrices(jnp.asarray(matrices), jnp.asarray(matrices + np.swapaxes(matrices, 1, 2)))
    parts, changes, rates = solved_columns(stages, jnp.asarray(weights), jnp.asarray(base), jnp.asarray(base), 1e-8)

    def changing(columns):
        inner = np.swapaxes(columns, 1, 2) @ matrices @ columns
        return matrices @ columns - columns @ (np.triu(inner) + np.swapaxes(np.tril(inner, -1), 1, 2)), inner

    def left(flat):
        columns = flat.reshape(base.shape)
        return (columns - np.einsum("il,lab->iab", weights, changing(columns)[0]) - base).ravel()

    exact = scipy.optimize.root(left, base.ravel(), tol=1e-14).x.reshape(base.shape)
    derivative, inner = changing(exact)
    assert_allclose(parts, exact, atol=1e-12)
    assert_allclose(changes, derivative, atol=1e-12)
    assert_allclose(rates, np.diagonal(inner, axis1=1, axis2=2), atol=1e-12)


METHODS = {"Radau IIA": lh.RadauIIA(1e-8), "ESDIRK54b": lh.ESDIRK("esdirk54b", 1e-8, atol=1e-8)}
ERRORS = {"Radau IIA": 1e-9, "ESDIRK54b": 1e-7}  # of exponents that are small beside the largest


@pytest.mark.slow_cases(all_but=("Robertson-ESDIRK54b",))
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", FLOWS)
def test_all_exponents_in_few_steps(name, method):

    s = spectrum(name, lh.ContinuousQR(METHODS[method]), max_steps=80_000)
    print(name, method, np.asarray(s.exponents) - REFERENCES[name])
    assert s.status is lh.STATUS.ok
    assert_allclose(s.exponents, REFERENCES[name], rtol=1e-9, atol=ERRORS[method])
    assert s.sum_rule_residual < 1e-7


@pytest.mark.slow_cases("kvaerno5")
@pytest.mark.parametrize("tableau", ["esdirk54b", "kvaerno5"])
def test_growth_along_a_relaxation_is_off_by_a_multiple_of_the_tolerance(tableau):
    """Van der Pol's column falls by nine orders after a jump, so that an error before it counts; see `lh.ESDIRK`."""
    tolerances = np.array([1e-8, 1e-9, 1e-10, 1e-11])
    one = {"frame": np.eye(2)[:, :1]}
    found = [spectrum("van der Pol", lh.ESDIRK(tableau, rtol), **one).exponents[0] for rtol in tolerances]
    errors = np.abs(np.array(found) - REFERENCES["van der Pol"][0]) * FLOWS["van der Pol"][2]
    assert np.all(errors < 5e6 * tolerances)
    assert np.all(errors[1:] < errors[:-1] / 5)  # a mistake in the derivative of a step would stay


@pytest.mark.slow
def test_a_column_falls_by_nine_orders_after_a_jump():
    """What the docstring of `lh.ESDIRK` says of van der Pol's flow: the column along it is the flow, by LSODA."""
    field, start, _ = FLOWS["van der Pol"]
    path = scipy.integrate.solve_ivp(lambda t, x: field(t, x, None, np), (0.0, 900.0), start, "LSODA", rtol=1e-8)
    speeds = np.linalg.norm(field(path.t, path.y, None, np), axis=0)
    assert np.max(speeds) > 1e9 * np.min(speeds[np.argmax(speeds) :])


@pytest.mark.slow
@pytest.mark.parametrize("name", FLOWS)
def test_the_references(name):
    field, start, length = FLOWS[name]
    s = spectrum(name, lh.RungeKutta(rtol=1e-10, atol=1e-12))
    assert_allclose(s.exponents, REFERENCES[name], rtol=1e-10, atol=1e-10)

    def slope(t, y):
        return np.append(field(t, y[:-1], None, np), TRACES[name](y))

    total = scipy.integrate.solve_ivp(slope, (0.0, length), [*start, 0.0], "LSODA", rtol=1e-9, atol=1e-12).y[-1, -1]
    assert_allclose(np.sum(REFERENCES[name]), total / length, rtol=1e-6)


TRACES = {
    "van der Pol": lambda x: 1000.0 * (1 - x[0] ** 2),
    "Oregonator": lambda x: 77.27 * (1 - x[1] - 2 * 8.375e-6 * x[0]) - (1 + x[0]) / 77.27 - 0.161,
    "Robertson": lambda x: -0.04 - 1e4 * x[2] - 6e7 * x[1],
}


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_derivatives_through_the_stages(method):
    """Forward and reverse ones against differences."""
    flow = lh.Flow(
        lambda t, x, a: jnp.stack([x[1] ** 2 / 2 - x[0] + jnp.sin(t), 50 * a * (jnp.sin(x[0]) - x[1]), x[0] - a * x[2]])
    )

    def exponents(a):
        inner = lh.ContinuousQR(METHODS[method])
        return lh.lyapunov_spectrum(flow, [0.3, 0.2, 0.1], a, t1=2.0, method=inner, blocks=2).exponents

    differences = (np.asarray(exponents(1.0 + 1e-4)) - np.asarray(exponents(1.0 - 1e-4))) / 2e-4
    for derivative in (jax.jacfwd, jax.jacrev):
        assert_allclose(derivative(exponents)(1.0), differences, rtol=1e-5, atol=1e-5)
