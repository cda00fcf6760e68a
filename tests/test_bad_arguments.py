"""Bad arguments are refused before anything is computed, with what was given, what was wanted and what to do."""

import jax
import jax.numpy as jnp
import pytest

import lyaphybrid as lh

DECAY = lh.Flow(lambda t, x, a: -x)
HENON = lh.zoo.henon_map()


def guard(t, x, a):
    """Falls where the first component does."""
    return x[0]


TWO_MODES = lh.Hybrid({"up": DECAY, "down": DECAY}, lh.Transition(guard, source="up", target="down"))

CONSTRUCTIONS = {
    "field must be a function": lambda: lh.Flow(3.0),
    "rule must be a function": lambda: lh.Map("x"),
    "exactly one of guard": lambda: lh.Transition(),
    "got guard=<function guard": lambda: lh.Transition(guard, every=1.0),
    "guard must be a function": lambda: lh.Transition(1.0),
    "reset must be a function": lambda: lh.Transition(guard, 1.0),
    "when must be a function": lambda: lh.Transition(guard, when=True),
    "direction must be": lambda: lh.Transition(guard, direction=2),
    "period, must be positive": lambda: lh.Transition(every=-1.0),
    "target must be None": lambda: lh.Transition(guard, target=1.5),
    "max_cascade must be": lambda: lh.Hybrid(DECAY, lh.Transition(guard), max_cascade=0),
    "must be lh.Transition objects": lambda: lh.Hybrid(DECAY, [guard]),
    "Unknown mode 'sideways'": lambda: lh.Hybrid(DECAY, lh.Transition(guard, source="sideways")),
    "as tangent": lambda: lh.Hybrid(DECAY, lh.Transition(guard), tangent={"stick": guard}),
    "at least one Transition": lambda: lh.Hybrid(DECAY, []),
    "with a reset to iterate": lambda: lh.Hybrid(None, lh.Transition(guard)),
    "The field of mode 'flow'": lambda: lh.Hybrid(2.0, lh.Transition(guard)),
    "next_event must be": lambda: lh.EventDriven(guard, None, guard, guard),
    "Unknown tableau": lambda: lh.RungeKutta("euler9"),
    "control must be": lambda: lh.RungeKutta(control="y"),
    "give a fixed step": lambda: lh.RungeKutta("rk4"),
    "rtol must be positive": lambda: lh.RungeKutta(rtol=-1.0),
    "dt must be positive": lambda: lh.RungeKutta(dt=0.0),
    "must be a diffrax solver": lambda: lh.Diffrax("Kvaerno5"),
}


@pytest.mark.parametrize("message", CONSTRUCTIONS)
def test_constructions_are_refused(message):
    """At construction."""
    with pytest.raises(ValueError, match=message):
        CONSTRUCTIONS[message]()


CALLS = {
    "system must be": (guard, [1.0], {}),
    "x0 must be real": (DECAY, [1j], {}),
    "x0 must have shape": (DECAY, 1.0, {}),
    "x0 must be finite": (DECAY, [float("nan")], {}),
    "t1, a length, must be positive": (DECAY, [1.0], {"t1": -1.0}),
    "transient, a length, must be positive": (DECAY, [1.0], {"transient": -1.0}),
    "clock must be one of": (DECAY, [1.0], {"clock": "weeks"}),
    "averaging must be one of": (DECAY, [1.0], {"averaging": "none"}),
    "orthonormalise must be one of": (DECAY, [1.0], {"orthonormalise": "qr"}),
    "blocks must be": (DECAY, [1.0], {"blocks": 1}),
    "k must be a positive integer": (DECAY, [1.0], {"k": 0}),
    "k must be at most n = 1": (DECAY, [1.0], {"k": 2}),
    "frame must have shape": (DECAY, [1.0, 2.0], {"frame": jnp.ones((3, 1))}),
    "linearly independent": (DECAY, [1.0, 2.0], {"frame": jnp.ones((2, 2))}),
    "every must be positive": (DECAY, [1.0], {"every": 0}),
    "until, a standard error": (DECAY, [1.0], {"until": 0.0}),
    "max_steps must be positive": (DECAY, [1.0], {"max_steps": 0}),
    "replicates must be at least 2": (DECAY, [1.0], {"replicates": 1}),
    "replicates needs key": (DECAY, [1.0], {"replicates": 2}),
    "exclude each other": (DECAY, [[1.0], [2.0]], {"replicates": 2, "key": jax.random.key(0)}),
    "times must be": (DECAY, [1.0], {"times": "linear"}),
    "positive, increasing array": (DECAY, [1.0], {"times": [2.0, 1.0]}),
    "times must end at t1": (DECAY, [1.0], {"times": [0.5, 2.0]}),
    "say which one it starts in": (TWO_MODES, [1.0], {}),
    "Unknown mode 'left'": (TWO_MODES, [1.0], {"mode": "left"}),
    "mode 5 is out of range": (TWO_MODES, [1.0], {"mode": 5}),
    "needs lh.RungeKutta or lh.Diffrax": (DECAY, [1.0], {"method": "dopri5"}),
    "A map is iterated": (HENON.system, [0.1, 0.1], {"method": lh.RungeKutta()}),
    "must return an array of x's shape": (lh.Flow(lambda t, x, a: x[0]), [1.0], {}),
}


@pytest.mark.parametrize("message", CALLS)
def test_calls_are_refused(message):
    """Before computing."""
    system, x0, keywords = CALLS[message]
    with pytest.raises(ValueError, match=message):
        lh.lyapunov_spectrum(system, x0, HENON.args, **({"t1": 1.0} | keywords))


def test_trajectory_and_tangent_map_refuse_too():
    """The same checks stand before them."""
    with pytest.raises(ValueError, match="t1, a length of time"):
        lh.trajectory(DECAY, [1.0], t1=0.0)
    with pytest.raises(ValueError, match="number of samples"):
        lh.trajectory(DECAY, [1.0], t1=1.0, n=0)
    with pytest.raises(ValueError, match="Use jax.vmap"):
        lh.tangent_map(DECAY, [[1.0]], t1=1.0)
