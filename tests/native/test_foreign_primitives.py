"""Primitives of other libraries, which have no rule: what they are made of is compiled."""

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Primitive

from lyaphybrid import native
from lyaphybrid._jax.reverse_mode import both_ways, checkpointed
from lyaphybrid.native.lowering.costs import Options

PLANS = {"in-memory": Options(1, 1), "entries": Options(64, 0)}


def check(function, *operands, plan, rtol=1e-12):
    found = native.compile(function, *operands, plan=PLANS[plan])(*operands)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(jax.jit(function)(*operands)), strict=True):
        assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype)
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=rtol)


def turned(x):
    return jnp.stack([0.9 * x[1], -jnp.sin(x[0]), x[2] + 0.1])


def looped(kind, **options):
    def function(x):
        goes_on, step = lambda s: s[0] < 5, lambda s: (s[0] + 1, turned(s[1]))
        return eqxi.while_loop(goes_on, step, (0, x), kind=kind, **options)[1]

    return function


def squared(function):
    return lambda x: jnp.sum(function(x) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("plan", PLANS)
def test_equinoxs_loops_and_their_derivatives(plan):
    x = jnp.asarray([0.5, -0.25, 1.0])
    kinds = {"lax": {}, "bounded": {"max_steps": 16}, "checkpointed": {"max_steps": 16, "checkpoints": 3}}
    for kind, options in kinds.items():
        check(looped(kind, **options), x, plan=plan)
        if kind != "lax":
            check(jax.grad(squared(looped(kind, **options))), x, plan=plan)


@pytest.mark.parametrize("plan", PLANS)
def test_equinoxs_marks(plan):
    def function(x):
        x = eqxi.nonbatchable(eqxi.nontraceable(eqxi.nondifferentiable(x)))
        return x * 2, eqxi.unvmap_any(x > 0), eqxi.unvmap_all(x > 0), eqxi.unvmap_max(x.astype(jnp.int32))

    check(function, jnp.asarray([0.5, -0.25, 3.0]), plan=plan)


@pytest.mark.slow_cases("in-memory")
@pytest.mark.parametrize("plan", PLANS)
def test_a_derivative_that_is_given_both_ways(plan):
    """The library's own primitive is made of its functions."""

    def loop(kind):
        def function(x):
            goes_on, step = lambda s: s[0] < 4, lambda s: (s[0] + 1, turned(s[1]))
            return (checkpointed if kind == "reverse" else jax.lax.while_loop)(goes_on, step, (0, x))[1]

        return function

    function = both_ways(loop("forward"), loop("reverse"))
    x = jnp.asarray([0.5, -0.25, 1.0])
    check(function, x, plan=plan)
    check(jax.jacfwd(function), x, plan=plan)
    check(jax.grad(squared(function)), x, plan=plan)


def test_lanes_that_have_finished_keep_what_they_have():
    def function(x):
        goes_on, step = lambda s: (s[0] < 9) & (s[1][2] < 1.5), lambda s: (s[0] + 1, turned(s[1]))
        return eqxi.while_loop(goes_on, step, (0, x), kind="bounded", max_steps=16)

    x = jnp.asarray(np.random.default_rng(0).normal(size=(3, 4)))
    closed = jax.make_jaxpr(function)(x[:, 0])
    found = native.Compiled(closed, lanes=4, wide=(True,), plan=Options(64, 1))(x)
    wanted = jax.tree.leaves(jax.vmap(function, in_axes=-1, out_axes=-1)(x))
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_an_implementation_that_cannot_be_traced_is_none():
    by_numpy = Primitive("by_numpy")
    by_numpy.def_impl(lambda x: jnp.asarray(np.asarray(x)[::-1]))
    by_numpy.def_abstract_eval(lambda x: x)
    with pytest.raises(native.UnsupportedError, match="the primitive by_numpy"):
        native.compile(lambda x: by_numpy.bind(x), jnp.ones(3))


@pytest.mark.slow_cases("in-memory")
@pytest.mark.parametrize("plan", PLANS)
def test_modules(plan):
    layer = eqx.nn.MLP(3, 2, 8, 1, key=jax.random.key(0))
    check(lambda x: layer(x), jnp.asarray([0.5, -0.25, 1.0]), plan=plan)
