"""Derivatives of event times of closed-form systems come from the guard, however `next_event` finds the time."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

# A ball that falls with the acceleration 1 onto a floor at the height b, and keeps r of its speed.
ARGS = {"b": 0.1, "r": 0.9}
X0 = np.array([1.0, 0.2])


def flow(dt, t, x, args):
    return jnp.stack([x[0] + dt * x[1] - dt**2 / 2, x[1] - dt])


def by_formula(t, x, args):
    return x[1] + jnp.sqrt(x[1] ** 2 + 2 * (x[0] - args["b"])), 0


def by_bisection(t, x, args, while_loop=False):
    """The same time, between that of the vertex and one that is late enough, without derivatives."""

    def halved(ends):
        low, high = ends
        middle = (low + high) / 2
        above = flow(middle, t, x, args)[0] > args["b"]
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    ends = jnp.maximum(x[1], 0.0), jnp.maximum(x[1], 0.0) + 8.0
    if while_loop:
        low, high = jax.lax.while_loop(lambda ends: ends[1] - ends[0] > 1e-15, halved, ends)
    else:
        low, high = jax.lax.fori_loop(0, 60, lambda i, ends: halved(ends), ends)
    return (low + high) / 2, 0


def ball(next_event):
    return lh.EventDriven(
        flow,
        next_event,
        jump=lambda t, x, args, which: jnp.stack([x[0], -args["r"] * x[1]]),
        guard=lambda t, x, args, which: x[0] - args["b"],
    )


FORMULA, BISECTION = ball(by_formula), ball(by_bisection)
DATA_DEPENDENT = ball(functools.partial(by_bisection, while_loop=True))


def end(system, x0, args):
    return lh.trajectory(system, x0, args, t1=5.0, n=1).x[-1]


@pytest.mark.parametrize("system", [BISECTION, DATA_DEPENDENT])
def test_derivatives_of_trajectories(system):
    wanted = jax.jacfwd(end, argnums=(1, 2))(FORMULA, X0, ARGS)
    h = 1e-6
    higher, lower = (end(FORMULA, X0, ARGS | {"b": 0.1 + step}) for step in (h, -h))
    assert_allclose(wanted[1]["b"], (higher - lower) / (2 * h), rtol=1e-7)
    found = jax.jacfwd(end, argnums=(1, 2))(system, X0, ARGS)
    jax.tree.map(functools.partial(assert_allclose, rtol=1e-10, atol=1e-12), found, wanted)
    backwards = jax.jacrev(end, argnums=(1, 2))(system, X0, ARGS)
    jax.tree.map(functools.partial(assert_allclose, rtol=1e-10, atol=1e-12), backwards, wanted)
    assert_allclose(found[0], lh.tangent_map(system, X0, ARGS, t1=5.0).matrix, rtol=1e-10)


def test_derivatives_of_exponents():
    def exponents(system, r):
        return lh.lyapunov_spectrum(system, X0, ARGS | {"r": r}, t1=5.0, transient=0.0).exponents

    assert_allclose(*(jax.jacfwd(functools.partial(exponents, one))(0.9) for one in (BISECTION, FORMULA)), rtol=1e-7)


def many_balls(next_time):
    """The same, two balls with a schedule; comoving coordinates are height and speed at the rebasing."""

    def times(t, y, args):
        ahead = flow(t, 0.0, y.T, args)
        return t + jax.vmap(lambda x: next_time(0.0, x, args)[0], in_axes=1)(ahead)

    def jump(t, rows, args, which):
        height, speed = flow(t, 0.0, rows[0], args)
        return flow(-t, 0.0, jnp.stack([height, -args["r"] * speed]), args)[None]

    return lh.EventDriven(
        lambda dt, y, args: flow(dt, 0.0, y.T, args).T,
        None,
        jump=jump,
        guard=lambda t, rows, args, which: flow(t, 0.0, rows[0], args)[0] - args["b"],
        schedule=lh.Schedule(
            init=times,
            next=lambda times: (jnp.min(times), jnp.argmin(times)),
            update=lambda known, t, y, args, which: known.at[which].set(times(t, y, args)[which]),
            shift=lambda times, dt: times - dt,
            touch=lambda which: which[None],
        ),
    )


def test_derivatives_with_a_schedule():
    x0 = jnp.stack([X0, X0 + 0.3])
    found, wanted = (
        jax.jacfwd(end, argnums=(1, 2))(many_balls(next_time), x0, ARGS) for next_time in (by_bisection, by_formula)
    )
    jax.tree.map(functools.partial(assert_allclose, rtol=1e-9, atol=1e-11), found, wanted)
    alone = jax.jacfwd(end, argnums=(1, 2))(FORMULA, X0, ARGS)
    assert_allclose(found[0][0, :, 0], alone[0], rtol=1e-9)
    assert_allclose(found[1]["b"][0], alone[1]["b"], rtol=1e-9)
