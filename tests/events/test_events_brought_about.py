"""Events of closed-form systems that a jump brings about: a neuron lifted over its threshold fires at that instant."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

CURRENTS = np.array([1.513, 1.297, 1.409, 1.358, 1.446])
START = np.array([0.5, 0.75, 0.1, 0.3, 0.62])


def kicked(t, x, w, which):
    """Neuron `which` falls to 0 and lifts all others by w."""
    return jnp.where(jnp.arange(x.shape[0], dtype=jnp.asarray(which).dtype) == which, 0.0, x + w)


def waits(x):
    """Times until each neuron is at its threshold 1."""
    current = jnp.asarray(CURRENTS[: x.shape[0]])
    return jnp.log((current - jnp.minimum(x, 1)) / (current - 1))


def flow(dt, t, x, w):
    current = jnp.asarray(CURRENTS[: x.shape[0]])
    return current + (x - current) * jnp.exp(-dt)


CLOSED = lh.EventDriven(
    flow,
    next_event=lambda t, x, w: (jnp.min(waits(x)), jnp.argmin(waits(x))),
    jump=kicked,
    guard=lambda t, x, w, which: 1 - x[which],
)
HYBRID = lh.Hybrid(
    lambda t, x, w: jnp.asarray(CURRENTS[: x.shape[0]]) - x, lh.Transition(lambda t, x, w: 1 - x, kicked), max_cascade=8
)


def simulated(x, w, t1):
    """The end, and all (time, neuron)."""
    x, current, t, spikes = np.array(x), CURRENTS[: len(x)], 0.0, []
    while True:
        left = np.log((current - np.minimum(x, 1)) / (current - 1))
        which = int(np.argmin(left))
        dt = min(left[which], t1 - t)
        x, t = current + (x - current) * np.exp(-dt), t + dt
        if dt < left[which]:
            return x, spikes
        x = np.where(np.arange(len(x)) == which, 0.0, x + w)
        spikes.append((t, which))


def by_differences(x, w, t1, h=1e-6):
    ends = [[simulated(x + sign * h * unit, w, t1)[0] for sign in (1, -1)] for unit in np.eye(len(x))]
    return np.array([(more - less) / (2 * h) for more, less in ends]).T


@pytest.mark.parametrize(("n", "w", "t1"), [(2, 0.3, 1.0), (2, 0.3, 3.0), (5, 0.2, 2.5)])
def test_trajectories_and_tangent_maps(n, w, t1):
    x0 = START[:n]
    end, spikes = simulated(x0, w, t1)
    times = [t for t, _ in spikes]
    assert len(times) > len(set(times))  # some follow others at once
    found = lh.trajectory(CLOSED, x0, w, t1=t1, n=1)
    assert_allclose(found.x[-1], end, atol=1e-13)
    assert_allclose(found.events.t, times, atol=1e-13)
    assert found.events.which.tolist() == [which for _, which in spikes]
    tangent = lh.tangent_map(CLOSED, x0, w, t1=t1)
    assert_allclose(tangent.matrix, by_differences(x0, w, t1), atol=1e-8)
    assert int(tangent.jumps) == len(spikes)


@pytest.mark.parametrize("clock", ["time", "jumps"])
@pytest.mark.parametrize(("n", "w"), [(2, 0.3), (5, 0.1031), (5, 0.2017)])
def test_exponents_are_those_of_the_system_with_guards(n, w, clock):
    def of(system, k):
        return lh.lyapunov_spectrum(system, START[:n], w, t1=100.0, transient=10.0, clock=clock, k=k)

    assert_allclose(of(CLOSED, 1).exponents, of(HYBRID, 1).exponents, atol=1e-9)
    closed, hybrid = of(CLOSED, n), of(HYBRID, n)
    assert int(closed.jumps) == int(hybrid.jumps)
    assert (
        np.isneginf(closed.exponents).tolist() == np.isneginf(hybrid.exponents).tolist() == [False, *[True] * (n - 1)]
    )
    if n == 2:
        assert closed.losses.tolist() == hybrid.losses.tolist()


def test_derivatives_by_parameters():
    def end(w):
        return lh.trajectory(CLOSED, START[:2], w, t1=1.5, n=1).x[-1, 1]

    x, h = START[:2], 1e-6
    slope = (simulated(x, 0.3 + h, 1.5)[0][1] - simulated(x, 0.3 - h, 1.5)[0][1]) / (2 * h)
    assert abs(slope) > 0.1
    assert_allclose([jax.jacfwd(end)(0.3), jax.grad(end)(0.3)], slope, rtol=1e-8)


def test_a_start_beyond_a_threshold_fires_at_the_time_of_the_start():
    x0 = np.array([0.5, 1.2])
    found = lh.tangent_map(CLOSED, x0, 0.1, t1=0.3)
    assert_allclose(found.matrix, np.diag([np.exp(-0.3), 0.0]), atol=1e-15)


def test_spikes_without_end_at_one_instant():
    with np.errstate(all="ignore"):
        found = lh.lyapunov_spectrum(CLOSED, START[:2], 1.05, t1=5.0, throw=False)
    assert found.status is lh.STATUS.zeno


def by_schedule():
    """The same neurons in comoving coordinates; each spike touches all."""

    def spikes(t, y, w):
        return t + waits(flow(t, 0.0, y, w))

    return lh.EventDriven(
        lambda dt, y, w: flow(dt, 0.0, y, w),
        None,
        jump=lambda t, rows, w, which: flow(-t, 0.0, kicked(t, flow(t, 0.0, rows, w), w, which), w),
        guard=lambda t, rows, w, which: 1 - flow(t, 0.0, rows, w)[which],
        schedule=lh.Schedule(
            init=spikes,
            next=lambda times: (jnp.min(times), jnp.argmin(times)),
            update=lambda times, t, y, w, which: spikes(t, y, w),
            shift=lambda times, dt: times - dt,
            touch=lambda which: jnp.arange(2),
            flat=True,
        ),
    )


def test_with_a_schedule_the_perturbations_of_such_a_run_are_refused():
    end, spikes = simulated(START[:2], 0.3, 3.0)
    found = lh.trajectory(by_schedule(), START[:2], 0.3, t1=3.0, n=1)
    assert_allclose(found.x[-1], end, atol=1e-13)
    assert len(found.events) == len(spikes)
    with pytest.raises(lh.RunFailedError, match="give next_event instead"):
        lh.lyapunov_spectrum(by_schedule(), START[:2], 0.3, t1=3.0)
    (finding,) = (one for one in lh.check(by_schedule(), START[:2], 0.3).findings if one.topic == "instants")
    assert (finding.verdict, "give next_event instead" in finding.text) == ("wrong", True)
    (finding,) = (one for one in lh.check(by_schedule(), START[:2], -0.1).findings if one.topic == "instants")
    assert finding.verdict == "right"
    apart = lh.tangent_map(by_schedule(), START[:2], -0.1, t1=3.0)  # no spike brings about another
    assert_allclose(apart.matrix, by_differences(START[:2], -0.1, 3.0), atol=1e-8)
    start = lh.tangent_map(by_schedule(), [0.5, 1.2], 0.1, t1=0.3)
    assert_allclose(start.matrix, np.diag([np.exp(-0.3), 0.0]), atol=1e-15)


def test_labels_of_several_numbers_are_trees():
    def next_event(t, x, w):
        return jnp.min(waits(x)), jnp.stack([jnp.argmax(x), jnp.argmin(waits(x))])

    paired = lh.EventDriven(
        flow, next_event, lambda t, x, w, which: kicked(t, x, w, which[1]), lambda t, x, w, which: 1 - x[which[1]]
    )
    with pytest.raises(ValueError, match=r"as in \(i, j\); got shape \(2,\)"):
        lh.trajectory(paired, START[:2], 0.1, t1=1.0)
