"""Primitives of other libraries: Equinox's, Lineax's, and any that is implemented by a function of arrays."""

import diffrax
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Primitive

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options

PLANS = (Options(1, 2), Options(64, 0))


def agree(function, *operands, tolerance=1e-12):
    expected = jax.tree.leaves(jax.jit(function)(*operands))
    for plan in PLANS:
        found = jax.tree.leaves(native.compile(function, *operands, plan=plan, checked=True)(*operands))
        for x, y in zip(found, expected, strict=True):
            np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance, err_msg=str(plan))


def test_unvmap():
    agree(eqxi.unvmap_any, np.array([False, True]))
    agree(eqxi.unvmap_all, np.array([False, True]))
    agree(eqxi.unvmap_max, np.array([3, 5, 1]))


def looped(kind, n):
    def function(x, many):
        def step(state):
            i, x, kept = state
            return i + 1, jnp.sin(x) + 0.1 * x, kept.at[i].set(x[0])

        state = (0, x, jnp.zeros(n))
        options = {"kind": kind, "max_steps": n, "buffers": lambda state: state[2]}
        if kind == "checkpointed":
            options["checkpoints"] = 4
        return eqxi.while_loop(lambda state: state[0] < many, step, state, **options)[1:]

    return function


@pytest.mark.parametrize("small", [1, 16])
def test_what_a_loop_selects_in_lanes(small):
    """For each lane by itself; without lanes the condition holds."""
    function = eqxi.select_if_vmap_p.bind
    condition, x, y = np.array([True, False]), np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([5.0, 6.0])
    found = native.compile(
        function, True, x[:, 0], y, lanes=2, wide=(True, True, False), plan=Options(small, 1)
    )(condition, x, y)  # fmt: skip
    np.testing.assert_array_equal(found, [[1.0, 5.0], [3.0, 6.0]])
    agree(function, np.array(True), x, x + 1)


@pytest.mark.parametrize("kind", ["lax", "checkpointed", "bounded"])
@pytest.mark.parametrize("n", [6, 40])
def test_loops(kind, n):
    agree(looped(kind, n), np.array([0.5, 1.5, 2.5]), n - 2)


@pytest.mark.slow_cases("checkpointed")
@pytest.mark.parametrize("kind", ["checkpointed", "bounded"])
def test_gradients_of_loops(kind):
    def total(x, many):
        x, kept = looped(kind, 9)(x, many)
        return jnp.sum(x) + jnp.sum(kept**2)

    agree(jax.grad(total), np.array([0.5, 1.5, 2.5]), 7)


@pytest.mark.slow_cases("solver1")
@pytest.mark.parametrize("solver", [diffrax.Dopri5(), diffrax.Kvaerno5()])
def test_diffrax(solver):
    def solve(x, mu):
        term = diffrax.ODETerm(lambda t, x, mu: jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]))
        controller = diffrax.PIDController(rtol=1e-6, atol=1e-9)
        solution = diffrax.diffeqsolve(
            term, solver, 0.0, 1.0, 0.01, x, mu, stepsize_controller=controller, throw=False, max_steps=200
        )
        return solution.ys, solution.stats["num_steps"]

    agree(solve, np.array([1.0, 0.5]), 2.0, tolerance=1e-9)


def test_a_primitive_is_expanded_by_its_implementation():
    primitive = Primitive("a_primitive_of_my_own")
    primitive.def_impl(lambda x, *, factor: jnp.sin(x) * factor)
    primitive.def_abstract_eval(lambda x, *, factor: x)
    program = jax.make_jaxpr(lambda x: primitive.bind(x, factor=2.0) + 1)(np.arange(3.0))
    for plan in PLANS:
        (found,) = native.Compiled(program, plan=plan)(np.arange(3.0))
        np.testing.assert_allclose(found, np.sin(np.arange(3.0)) * 2 + 1, rtol=1e-15)


def test_a_primitive_without_one_is_refused():
    primitive = Primitive("a_primitive_without_implementation")
    primitive.def_abstract_eval(lambda x: x)
    program = jax.make_jaxpr(lambda x: primitive.bind(x))(1.0)
    with pytest.raises(native.UnsupportedError, match="a_primitive_without_implementation"):
        native.Compiled(program)
