"""Starts beyond a guard, which then does not fire: noted where the motion never comes back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

# A switch that opens where the current rises to 1; a clock closes it. The current decays to 3, or to 0.
TICK = lh.Transition(every=1.0, target="on")
OPENS = lh.Transition(lambda t, x, args: x[0] - 1.0, source="on", target="off", direction=1)
BELOW = lh.Transition(lambda t, x, args: x[1] - args["record"], source="on")  # records, where it is reached
COIL = lh.Hybrid(
    {
        "on": lambda t, x, args: jnp.stack([3.0 - x[0], jnp.cos(2 * jnp.pi * t)]),
        "off": lambda t, x, args: jnp.stack([-x[0], jnp.cos(2 * jnp.pi * t)]),
    },
    [TICK, OPENS, BELOW],
)


def noted(system, start, args=None, **how):
    return "beyond_guard" in lh.lyapunov_spectrum(system, start, args, **{"t1": 8.0, "blocks": 8} | how).notes


@pytest.mark.parametrize("record", [0.0, 9.0])
@pytest.mark.parametrize("transient", [0.0, 5.0])
def test_a_comparator_that_the_start_is_beyond(record, transient):
    """Whether another guard is reached or not, and with a transient."""
    args = {"record": record}
    assert noted(COIL, [2.0, 0.0], args, mode="on", transient=transient)
    assert not noted(COIL, [0.5, 0.0], args, mode="on", transient=transient)
    assert not noted(COIL, [2.0, 0.0], args, mode="off", transient=transient)  # it falls below 1 before the clock ticks


def test_a_motion_that_comes_back_is_not_noted():
    """An oscillator that begins beyond its guard, which then fires once a turn."""
    turns = lambda t, x, args: jnp.stack([x[1], -x[0]])  # noqa: E731
    kicked = lh.Transition(lambda t, x, args: x[0] - 0.3, lambda t, x, args: 1.0 * x)
    assert not noted(lh.Hybrid(turns, kicked), [-1.0, 0.0], t1=20.0)


def test_it_is_noted_until_it_comes_back():
    """A body that rises through its guard after a time of 2: before, nobody can tell."""
    rising = lh.Hybrid(
        lambda t, x, args: jnp.ones_like(x), lh.Transition(lambda t, x, args: x[0] - 2.0, lambda t, x, args: 0 * x)
    )
    assert noted(rising, [0.0], t1=1.5)
    assert not noted(rising, [0.0], t1=3.0)


@pytest.mark.parametrize(("count", "beyond"), [(3, 0), (3, 2), (25, 0), (25, 19), (25, 20), (25, 24)])
def test_one_of_several_entries_of_a_guard(count, beyond):
    """Of many guards the first twenty are followed."""
    decays = lh.Hybrid(
        lambda t, x, args: -x, lh.Transition(lambda t, x, args: x + 2.0, lambda t, x, args, which: x.at[which].set(0.0))
    )
    assert noted(decays, jnp.zeros(count).at[beyond].set(-1e9)) == (beyond < 20)
    assert not noted(decays, jnp.ones(count))


def test_in_sweeps_and_under_vmap():
    def run(args):
        return lh.lyapunov_spectrum(COIL, [args["start"], 0.0], args, t1=8.0, blocks=8, mode="on")

    args = {"record": 0.0, "start": 0.0}
    found = lh.sweep(run, {"start": [0.5, 2.0, 0.9]}, args=args, progress=False)
    together = jax.vmap(lambda start: run(args | {"start": start}).flags)(jnp.array([0.5, 2.0, 0.9]))
    assert np.asarray(together)[:, 3].tolist() == [0.0, 1.0, 0.0]
    bits = np.asarray(found.notes)
    assert np.count_nonzero(bits & 256) == 1
    assert bits[1] & 256  # the ninth of the notes that the attributes name


def test_a_diagram_says_it():
    how = {"over": {"record": [0.0, 0.1]}, "period": 1.0, "t1": 16, "samples": 8, "directions": ("up",)}
    found = lh.bifurcation_diagram(COIL, [2.0, 0.0], {"record": 0.0}, mode="on", **how)
    assert set(found.labels.ravel()) == {"beyond_guard"}
    assert set(lh.bifurcation_diagram(COIL, [0.5, 0.0], {"record": 0.0}, mode="on", **how).labels.ravel()) == {"P1w0"}


def test_a_diagram_does_not_follow_a_motion_that_never_fired():
    """The start 2 is beyond a threshold of 1, not of 2.5: there the current does not start from 3, where it rested."""
    opens = lh.Transition(lambda t, x, args: x[0] - args["peak"], source="on", target="off", direction=1)
    coil = lh.Hybrid({"on": lambda t, x, args: 3.0 - x, "off": lambda t, x, args: -x}, [TICK, opens])
    how = {"over": {"peak": [1.0, 2.5]}, "period": 1.0, "t1": 16, "samples": 8, "directions": ("up",), "mode": "on"}
    found = lh.bifurcation_diagram(coil, [2.0], {"peak": 1.0}, **how)
    assert [label == "beyond_guard" for label in found.labels.ravel()] == [True, False]
    assert np.all(found.points[1] < 2.5)


@pytest.mark.parametrize(("start", "beyond"), [(0.5, False), (2.0, True)])
def test_trajectories_say_it(start, beyond):
    found = lh.trajectory(COIL, [start, 0.0], {"record": 0.0}, t1=4.0, n=8, mode="on")
    assert found.notes == ({"beyond_guard"} if beyond else set())
    assert ("beyond_guard: the start is beyond a guard" in str(found)) == beyond
    flags = jax.jit(lambda x: lh.trajectory(COIL, x, {"record": 0.0}, t1=4.0, n=8, mode="on").beyond_guard)
    assert bool(flags(jnp.array([start, 0.0]))) == beyond


def test_of_several_runs_one_is_enough():
    """Replicates from starts of which one is beyond."""
    found = lh.lyapunov_spectrum(
        COIL, jnp.array([[0.5, 0.0], [2.0, 0.0]]), {"record": 0.0}, t1=8.0, blocks=8, mode="on"
    )
    assert "beyond_guard" in found.notes
    assert found.flags[:, 3].tolist() == [0.0, 1.0]
