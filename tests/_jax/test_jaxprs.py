"""Parts of user functions: what is computed before a loop, and what in it."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from examples import primitives
from lyaphybrid._jax.hashes import hash_of_function
from lyaphybrid._jax.jaxprs import divided, partially_evaluated


def oscillator(zeta):
    """A field with a number that its parameter alone decides."""
    return lambda t, x: {"slope": jnp.stack([x[1], -2 * jnp.exp(zeta) * x[1] - x[0]]), "time": t}


def test_the_settled_function_is_the_function():
    x = jnp.array([0.3, -0.2])
    got, wanted = partially_evaluated(oscillator(jnp.asarray(0.1)), 0.5, x)(0.7, 2 * x), oscillator(0.1)(0.7, 2 * x)
    assert jax.tree.structure(got) == jax.tree.structure(wanted)
    np.testing.assert_allclose(got["slope"], wanted["slope"], rtol=1e-15)
    assert float(got["time"]) == 0.7


def test_what_parameters_decide_is_computed_before_the_loop():
    def run(settle, zeta, x):
        field = oscillator(zeta)
        field = partially_evaluated(field, 0.0, x) if settle else field
        return jax.lax.fori_loop(0, 3, lambda i, x: x + 0.1 * field(0.0, x)["slope"], x)

    for settle in (False, True):
        closed = jax.make_jaxpr(lambda zeta, x, settle=settle: run(settle, zeta, x))(0.1, jnp.ones(2))
        loops = [eqn for eqn in closed.eqns if eqn.primitive.name in ("scan", "while")]
        assert ("exp" in primitives(loops)) == (not settle)
        assert "exp" in primitives(closed.jaxpr.eqns)


def test_derivatives_by_parameters_pass():
    x = jnp.array([0.3, -0.2])

    def slope(zeta):
        return partially_evaluated(oscillator(zeta), 0.0, x)(0.0, x)["slope"][1]

    np.testing.assert_allclose(jax.grad(slope)(0.1), -2 * np.exp(0.1) * x[1], rtol=1e-15)


def test_division_by_what_is_known():
    closed = jax.make_jaxpr(lambda t, x: jnp.cos(2 * t) * x + jnp.sin(x))(0.0, 1.0)
    early, late, kept = divided(closed, closed.jaxpr.invars[:1])
    assert [eqn.primitive.name for eqn in early] == ["mul", "cos"]
    assert {eqn.primitive.name for eqn in late} == {"mul", "sin", "add"}
    assert kept == list(early[-1].outvars)


def test_hashes_of_programs_whose_parts_have_constants():
    """The parts of a linear solution are jaxprs with constants, which the equation around them holds."""

    def solved(number):
        def function(a):
            return jax.lax.custom_linear_solve(lambda x: number * a * x, a, lambda _, b: b / (number * a))

        return hash_of_function(function, jnp.ones(()))

    assert solved(2.0) == solved(2.0) != solved(3.0)

    def root(a):
        return optimistix.root_find(lambda x, _: x**2 - a, optimistix.Newton(1e-9, 1e-9), a).value

    assert hash_of_function(jax.grad(root), 2.0) == hash_of_function(jax.grad(root), 2.0)
