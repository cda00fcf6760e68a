"""Stores and checkpoints know their system: whatever is changed in its functions, they are those of another one."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh


def decay(rate=0.1, shape=jnp.sin):
    return lh.Flow(lambda t, x, args: -(rate + args) * shape(x))


def weighed(weights):
    return lh.Flow(lambda t, x, args: -(jnp.mean(jnp.asarray(weights)) + args) * x)


def ball(floor=0.0, restitution=0.8, direction=-1, terminal=False, **when):
    bounce = lh.Transition(
        lambda t, x, args: x[0] - floor,
        lambda t, x, args: jnp.stack([x[0], -restitution * x[1]]),
        direction=direction,
        terminal=terminal,
        **when,
    )
    return lh.Hybrid(lambda t, x, args: jnp.stack([x[1], -args]), bounce)


def kicked(every=1.0, phase=0.0):
    return lh.Hybrid(
        lambda t, x, args: -args * x, lh.Transition(every=every, phase=phase, reset=lambda t, x, args: 1.5 * x)
    )


def logistic(r=3.5):
    return lh.Map(lambda n, x, args: r * args * x * (1 - x))


PAIRS = {
    "a number in a field": (decay(), decay(0.2)),
    "its last digit": (decay(0.1), decay(0.1 + 1.4e-17)),
    "a function in a field": (decay(), decay(shape=jnp.tanh)),
    "an array in a field": (weighed(np.ones(5)), weighed(np.array([1.0, 1.0, 3.0, 1.0, 1.0]))),
    "a number in a map": (logistic(), logistic(3.9)),
    "a number in a guard": (ball(), ball(0.3)),
    "a number in a reset": (ball(), ball(restitution=0.9)),
    "a direction": (ball(), ball(direction=0)),
    "terminal": (ball(), ball(terminal=True)),
    "when": (ball(), ball(when=lambda t, x, args: x[0] < 10)),
    "the period of a clock": (kicked(), kicked(2.0)),
    "its phase": (kicked(), kicked(phase=0.5)),
}


OF_A_BALL = ("a number in a guard", "a number in a reset", "a direction", "terminal", "when")


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_a_sweep_of_a_changed_system_is_another_one(name):
    def of(system):
        def run(args):
            return lh.lyapunov_spectrum(system, [1.0, 0.0] if name in OF_A_BALL else [0.3], args, t1=2.0, throw=False)

        return lh.sweep(run, {"args": [1.0]}, args=1.0, progress=False).attrs["problem"]

    one, other = PAIRS[name]
    assert of(one) == of(one)
    assert of(one) != of(other)


@pytest.mark.slow
def test_a_store_is_not_used_for_a_changed_system(tmp_path):
    def swept(system):
        def run(args):
            return lh.lyapunov_spectrum(system, [1.0], args, t1=2.0)

        return lh.sweep(run, {"args": [1.0, 2.0]}, args=1.0, store=tmp_path / "sweep.zarr", progress=False)

    assert swept(kicked()).equals(swept(kicked()))
    with pytest.raises(ValueError, match="holds another sweep: its problem is"):
        swept(kicked(2.0))


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), [(logistic(), logistic(3.9)), (kicked(), kicked(2.0))])
def test_a_checkpoint_is_not_used_for_a_changed_system(one, other, tmp_path):
    def run(system):
        return lh.lyapunov_spectrum(system, [0.3], 1.0, t1=100, checkpoint=tmp_path / "run.npz", resume=True)

    np.testing.assert_array_equal(run(one).exponents, run(one).exponents)
    with pytest.raises(ValueError, match="another system, args or method"):
        run(other)
