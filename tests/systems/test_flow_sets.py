"""Flow set and jump set as data: where a state lies, and what becomes of one that may not flow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import STATUS


def fall(t, x, args):
    return jnp.stack([x[1], -1.0 + 0 * x[1]])


def height(t, x, args):
    return x[0]


def bounce(t, x, args):
    return jnp.stack([x[0], -args * x[1]])


BALL = lh.Hybrid(fall, lh.Transition(height, bounce), flow_set=height)


def test_where_a_state_lies():
    assert [BALL.contains([h, 0.0], 1.0).where for h in (1.0, 0.0, -1.0)] == ["C", "both", "D"]
    raised = lh.Hybrid(fall, lh.Transition(lambda t, x, a: x[0] - 1), flow_set=lambda t, x, a: x[0] - 1)
    assert [raised.contains([1 + d, 0.0]).where for d in (1e-15, -1e-15, 1e-9)] == ["both", "both", "C"]
    gap = lh.Hybrid(fall, lh.Transition(lambda t, x, a: x[0] + 1, when=lambda t, x, a: x[1] < 0), flow_set=height)
    assert gap.contains([-0.5, -1.0]).where == "neither"
    assert gap.contains([-1.5, -1.0]).where == "D"
    assert gap.contains([-1.5, 1.0]).where == "neither"
    rises = lh.Hybrid(fall, lh.Transition(lambda t, x, a: x[0] - 2, direction=1))
    assert [rises.contains([h, 0.0]).where for h in (1.0, 3.0)] == ["C", "both"]
    through = lh.Hybrid(fall, lh.Transition(height, direction=0))
    assert [through.contains([h, 0.0]).where for h in (1.0, 0.0, -1.0)] == ["C", "both", "C"]
    many = lh.Hybrid(fall, lh.Transition(lambda t, x, a: x, lambda t, x, a, which: x))
    assert [many.contains([1.0, v]).where for v in (1.0, -1.0)] == ["C", "both"]


def test_where_a_state_lies_in_time_and_in_modes():
    clock = lh.Transition(every=0.5, phase=0.25, reset=lambda t, x, a: x, source="a")
    system = lh.Hybrid({"a": fall, "b": fall}, clock, flow_set={"b": height})
    assert [system.contains([-1.0, 0.0], t=t, mode="a").where for t in (0.75, 0.5)] == ["both", "C"]
    assert system.contains([-1.0, 0.0], t=0.75, mode="b").where == "neither"
    with pytest.raises(ValueError, match=r"the modes \['a', 'b'\]"):
        system.contains([-1.0, 0.0])
    with pytest.raises(ValueError, match="Unknown mode 'c' as flow_set"):
        lh.Hybrid(fall, lh.Transition(height), flow_set={"c": height})


def test_systems_that_only_flow_or_only_jump():
    assert lh.Flow(fall).contains([1.0, 0.0]).where == "C"
    assert lh.Map(lambda n, x, a: x).contains([1.0]).where == "D"
    jumps = lh.Hybrid(None, lh.Transition(height, bounce))
    assert jumps.contains([1.0, 0.0], 1.0).where == "D"
    with pytest.raises(ValueError, match="empty flow set"):
        lh.Hybrid(None, lh.Transition(height, bounce), flow_set=height)


def test_under_a_transformation_there_are_truth_values():
    found = jax.vmap(lambda x: BALL.contains(x, 1.0))(jnp.array([[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]))
    assert np.asarray(found.flow).tolist() == [True, True, False]
    assert np.asarray(found.jump).tolist() == [False, True, True]
    with pytest.raises(ValueError, match="on the host"):
        jax.jit(lambda x: BALL.contains(x, 1.0).where)(jnp.array([1.0, 0.0]))


def run(system, start, args=None, **options):
    return lh.trajectory(system, start, args, t1=3.0, n=1, throw=False, **options)


@pytest.mark.slow
def test_a_flow_set_within_reach_changes_nothing():
    free = lh.trajectory(lh.Hybrid(fall, lh.Transition(height, bounce)), [0.5, 0.0], 0.9, t1=3.0, n=1)
    held = run(BALL, [0.5, 0.0], 0.9)
    assert held.status is STATUS.ok
    assert len(held.events) == len(free.events) == 2
    assert np.allclose(held.x, free.x, rtol=0, atol=1e-11)


def test_deadlock_where_the_flow_leaves_the_flow_set():
    """The floor is deeper than the set in which the ball may fall."""
    early = lh.Hybrid(fall, lh.Transition(height, bounce), flow_set=lambda t, x, args: x[0] - 0.1)
    path = run(early, [0.6, 0.0], 0.9)
    assert path.status is STATUS.deadlock
    assert len(path.events) == 0
    assert path.domain.sup_t == pytest.approx(1.0, abs=1e-10)
    assert not path.domain.complete


@pytest.mark.slow
def test_deadlock_of_a_start_outside_both():
    gap = lh.Hybrid(fall, lh.Transition(lambda t, x, args: x[0] + 1, bounce), flow_set=height)
    path = run(gap, [-0.5, 0.0], 0.9)
    assert path.status is STATUS.deadlock
    assert path.domain.sup_t == 0.0
    spectrum = lh.lyapunov_spectrum(gap, [-0.5, 0.0], 0.9, t1=3.0, blocks=3, throw=False)
    assert spectrum.status is STATUS.deadlock
    assert np.isnan(spectrum.exponents).all()


@pytest.mark.slow
def test_a_start_in_the_jump_set_alone_jumps_at_once():
    up = lh.Transition(height, lambda t, x, args: jnp.stack([x[0] + 2, args * x[1]]))
    path = run(lh.Hybrid(fall, up, flow_set=height), [-3.0, 1.0], 0.5)
    assert path.status is STATUS.ok
    log = path.events
    assert np.asarray(log.t)[:2].tolist() == [0.0, 0.0]  # a cascade: -3, -1, 1
    assert np.allclose(log.x_after[:2], [[-1.0, 0.5], [1.0, 0.25]], rtol=0, atol=1e-12)
    matrix = lh.tangent_map(lh.Hybrid(fall, up, flow_set=height), [-3.0, 1.0], 0.5, t1=0.5).matrix
    assert np.allclose(matrix, [[1, 0.125], [0, 0.25]], rtol=0, atol=1e-10)


def test_deadlock_after_a_jump_outside_both():
    down = lh.Transition(height, lambda t, x, args: jnp.stack([x[0] - 1, x[1]]), when=lambda t, x, args: x[0] > -0.5)
    path = run(lh.Hybrid(fall, down, flow_set=height), [0.5, 0.0])
    assert path.status is STATUS.deadlock
    assert len(path.events) == 1
    assert path.domain.sup_t == pytest.approx(1.0, abs=1e-12)


@pytest.mark.slow
def test_deadlock_on_the_border_where_the_exempt_guard_would_flow_through():
    """An identity reset leaves the ball on the floor, falling: without a flow set it falls through it."""
    still = lh.Transition(height)
    through = run(lh.Hybrid(fall, still), [0.5, 0.0])
    assert (through.status, len(through.events)) == (STATUS.ok, 1)
    path = run(lh.Hybrid(fall, still, flow_set=height), [0.5, 0.0])
    assert (path.status, len(path.events)) == (STATUS.deadlock, 1)


@pytest.mark.slow
def test_a_section_keeps_the_flow_set():
    def crossings(flow_set):
        system = lh.Hybrid(fall, lh.Transition(lambda t, x, args: x[0] + 9, bounce), flow_set=flow_set)
        section = lh.poincare_section(system, [0.5, 1.0], 1.0, section=lambda t, x, args: x[1], n=2, throw=False)
        return section.status

    assert crossings(height) is STATUS.deadlock
    assert crossings(None) is STATUS.ok
