"""Hybrid time domains, and which of Dinius' cases they look like."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import BALL, BALL_METHOD, ENDLESS_CASCADE, LOGISTIC, ball_args
from lyaphybrid import STATUS


def ball_domain(start=(0.5, 0.0), t1=20.0, t0=0.0, **changes) -> lh.TimeDomain:
    return lh.trajectory(BALL, start, ball_args(**changes), t1=t1, t0=t0, n=1, method=BALL_METHOD, throw=False).domain


def test_a_ball_that_bounces_for_ever():
    domain = ball_domain(t0=3.0, t1=6.0)
    assert np.allclose(domain.starts, [3, 4, 6, 8], rtol=0, atol=1e-12)
    assert np.allclose(domain.ends, [4, 6, 8, 9], rtol=0, atol=1e-12)
    assert (domain.case, domain.number, domain.complete) == ("hybrid", 3, True)
    assert (domain.sup_t, domain.sup_j) == (9.0, 3)
    assert "I^3 = [8, 9]" in str(domain)


def test_a_ball_that_comes_to_rest():
    domain = ball_domain((1.0, 0.0), restitution=0.8)
    assert (domain.case, domain.number) == ("zeno", None)
    first = math.sqrt(2)
    assert np.allclose(domain.ends[:3], first * np.array([1, 1 + 1.6, 1 + 1.6 + 1.28]), rtol=0, atol=1e-11)
    assert domain.sup_t < first * 9
    assert len(str(domain).splitlines()) == 8  # most of the intervals are left out


def test_one_that_only_flows_and_one_that_only_jumps():
    assert ball_domain(gravity=0.0).case == "continuous"
    flow = lh.trajectory(lh.Flow(lambda t, x, args: -x), [1.0], t1=2.0, n=1)
    assert (flow.domain.case, flow.domain.number, flow.domain.sup_j) == ("continuous", 4, 0)
    iterated = lh.trajectory(LOGISTIC, [0.3], 4.0, t1=7, n=7).domain
    assert (iterated.case, iterated.number, iterated.sup_t, iterated.sup_j) == ("discrete", 5, 0.0, 7)


def test_one_whose_jumps_stop():
    """A free particle meets a single wall once."""
    wall = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1]]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )
    domain = lh.trajectory(wall, [1.0, -1.0], t1=5.0, n=1).domain
    assert (domain.case, domain.number) == ("eventually continuous", 1)
    assert np.allclose(domain.starts, [0, 1], rtol=0, atol=1e-12)


def test_a_cascade_without_end():
    domain = lh.trajectory(ENDLESS_CASCADE, [0.5, 1.0], t1=2.2, n=1, throw=False).domain
    assert (domain.case, domain.number) == ("eventually discrete", 2)
    assert np.allclose(domain.starts, [0] + [0.5] * domain.sup_j, rtol=0, atol=1e-12)
    assert domain.sup_j > 3
    assert domain.ends[-1] == domain.starts[-1]


@pytest.mark.parametrize(
    ("changes", "status"),
    [({"floor": 0.0}, STATUS.deadlock), ({"gravity": -1.0, "ceiling": 0.6}, STATUS.terminated)],
    ids=["deadlock", "terminated"],
)
def test_one_that_ends(changes, status):
    path = lh.trajectory(BALL, [0.5, 0.0], ball_args(**changes), t1=20.0, n=1, method=BALL_METHOD, throw=False)
    assert path.status is status
    assert not path.domain.complete
    assert path.domain.sup_t == pytest.approx(1.0 if status is STATUS.deadlock else math.sqrt(0.2), abs=1e-12)


def test_the_time_reached_where_steps_ran_out():
    path = lh.trajectory(BALL, [0.5, 0.0], ball_args(), t1=1e4, n=1, method=BALL_METHOD, max_steps=300, throw=False)
    assert path.status is STATUS.max_steps
    domain = path.domain
    assert domain.case == "hybrid"
    assert domain.starts[-1] <= domain.sup_t < domain.starts[-1] + 2 + 1e-9
    assert domain.sup_j == len(path.events) > 5


def test_under_a_transformation_it_is_refused():
    def last(x):
        return lh.trajectory(LOGISTIC, x, 4.0, t1=3, n=3).domain.sup_j

    with pytest.raises(ValueError, match="on the host"):
        jax.jit(last)(jnp.array([0.3]))


def test_a_trajectory_has_samples_at_the_times_that_are_asked_for():
    """x = exp(−t); evenly in ln t, or at given times that end at t1."""
    decay = lh.Flow(lambda t, x, args: -x)
    even = lh.trajectory(decay, [1.0], t0=2.0, t1=5.0, n=4, times="log")
    np.testing.assert_allclose(even.t, 2.0 + 5.0 * np.geomspace(1e-3, 1, 4), rtol=1e-14)
    given = lh.trajectory(decay, [1.0], t1=5.0, times=[0.5, 2.0, 5.0], method=lh.RungeKutta(rtol=1e-12))
    np.testing.assert_allclose(given.x[:, 0], np.exp([-0.5, -2.0, -5.0]), rtol=1e-10)
    with pytest.raises(ValueError, match="times must end at t1"):
        lh.trajectory(decay, [1.0], t1=5.0, times=[0.5, 2.0])
