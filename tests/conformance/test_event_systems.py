"""Whole systems with events that users of other projects saw go wrong; each test names the public thread.

What is right is computed here by other means: in closed form, or by roots of exact motions. README.md lists them all.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import lyaphybrid as lh

# --- short pulses after long rest ------------------------------------------------------------------------------------

STARTS, ENDS = np.array([1.0, 60.0, 2000.0]), np.array([1.1, 60.05, 2000.001])

PULSES = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1] - x[0], 0 * x[1]]),
    [
        lh.Transition(lambda t, x, args: STARTS - t, lambda t, x, args, which: x.at[1].set(args)),
        lh.Transition(lambda t, x, args: ENDS - t, lambda t, x, args, which: x.at[1].set(0.0)),
    ],
)


@pytest.mark.parametrize("end", [1.5, 61.0, 2000.0005, 2001.0])
def test_a_short_pulse_after_a_long_rest(end):
    """https://github.com/scipy/scipy/issues/18039: a source in pieces; a pulse is stepped over once all is at rest.

    y' = s - y, where s is 5 during three pulses, the last of 0.001 after 1940 units of time in which nothing happens.
    """
    last = np.minimum(ENDS, end)
    exact = np.sum(np.where(end > STARTS, 5 * (np.exp(last - end) - np.exp(np.minimum(STARTS, end) - end)), 0.0))
    run = lh.trajectory(PULSES, [0.0, 0.0], 5.0, t1=end, n=1, method=lh.RungeKutta(rtol=1e-11, atol=1e-13))
    assert_allclose(run.x[-1, 0], exact, rtol=1e-9, atol=1e-13)
    assert_allclose(run.events.t, np.sort(np.concatenate([STARTS, ENDS]))[: len(run.events)], rtol=1e-14)
    assert len(run.events) == np.sum(end > STARTS) + np.sum(end > ENDS)


# --- a verge escapement ----------------------------------------------------------------------------------------------

TEETH, TORQUE, CROWN, VERGE, RESTITUTION = 15, 1.0, 10.0, 0.15, 0.05  # torque on the crown wheel; moments of inertia
R_CROWN, R_VERGE = 1.0, 0.3
PITCH = 2 * np.pi / TEETH
MASSES = CROWN / R_CROWN**2, VERGE / R_VERGE**2
SHARES = [(1 + RESTITUTION) * other / sum(MASSES) for other in MASSES[::-1]]  # of the closing speed, as new speeds
OPENING = SHARES[1] / R_VERGE * R_CROWN / (1 - RESTITUTION) * PITCH / 2  # the angle between the pallets


def _gaps(xp, x):
    """(2 · TEETH,) how far each tooth is beyond the upper pallet, and beyond the lower one."""
    forward = R_CROWN * xp.sin(x[0] - PITCH * np.arange(TEETH))
    return xp.concatenate(
        [
            side * forward * xp.cos(OPENING / 2 + side * x[1]) - R_VERGE * xp.sin(OPENING / 2 + side * x[1])
            for side in (1.0, -1.0)
        ]
    )


def _struck(xp, x, which):
    """The state after a tooth may have struck a pallet: it must be the tooth that faces it, and come nearer."""
    side, which = xp.where(which < TEETH, 1.0, -1.0), xp.asarray(which, float)
    facing = side * xp.cos(x[0] - PITCH * (which % TEETH)) >= np.cos(PITCH / 2)
    closing = R_CROWN * x[2] - side * R_VERGE * x[3]
    closing = xp.where(facing & (closing > 0), closing, 0.0)
    return xp.stack([x[0], x[1], x[2] - SHARES[0] / R_CROWN * closing, x[3] + side * SHARES[1] / R_VERGE * closing])


ESCAPEMENT = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[2], x[3], jnp.full_like(x[2], TORQUE / CROWN), 0 * x[3]]),
    lh.Transition(lambda t, x, args: _gaps(jnp, x), lambda t, x, args, which: _struck(jnp, x, which), direction=0),
)


def _by_roots(x, length):
    """Times and guards of all strokes, from the exact motion between them."""
    strokes, t = [], 0.0
    while True:

        def motion(s, x=x):
            return np.array([x[0] + x[2] * s + TORQUE / CROWN * s * s / 2, x[1] + x[3] * s])

        grid = np.concatenate([[1e-9], np.linspace(0, 2.0, 4001)[1:]])
        gaps = np.stack([_gaps(np, motion(s)) for s in grid])
        found = []
        for step, which in zip(*np.nonzero(gaps[:-1] * gaps[1:] < 0), strict=True):
            s = brentq(lambda s, which=which: _gaps(np, motion(s))[which], grid[step], grid[step + 1], xtol=1e-15)
            here = np.array([*motion(s), x[2] + TORQUE / CROWN * s, x[3]])
            after = _struck(np, here, which)
            if after[3] != here[3]:
                found.append((s, which, after))
        s, which, x = min(found, key=lambda one: one[0])
        t += s
        if t > length:
            return np.array([one[0] for one in strokes]), [one[1] for one in strokes]
        strokes.append((t, which))


@pytest.mark.slow
@pytest.mark.parametrize("start", [[0.0, 0.0, 0.0, 0.0], [0.0, -0.3, 0.2, 0.0], [0.05, 0.2, 0.5, -1.0]])
def test_a_clock_does_not_get_stuck_at_one_instant(start):
    """https://github.com/SciML/DifferentialEquations.jl/issues/703: 30 guards, of which most change nothing where met.

    A verge escapement: the wheel's teeth strike the two pallets in turn. Where a tooth passes a pallet that does not
    face it the state stays on the guard, as if it had just fired: the time did not go on there.
    """
    times, which = _by_roots(np.array(start), 15.0)
    run = lh.trajectory(ESCAPEMENT, start, t1=15.0, n=1, method=lh.RungeKutta(rtol=1e-11, atol=1e-13))
    strokes = np.asarray(run.events.x_after[:, 3] != run.events.x_before[:, 3])
    assert len(times) > 15
    assert len(run.events) > np.sum(strokes)
    assert np.asarray(run.events.which)[strokes].tolist() == which
    assert_allclose(np.asarray(run.events.t)[strokes], times, rtol=0, atol=1e-9)


# --- chattering ------------------------------------------------------------------------------------------------------

ABOVE, BELOW = np.array([-2.0, 1.5]), np.array([2.0, -3.0])  # x' and y' where x > y, and where x < y
MET = 1 / 7  # 0.5/3.5


def _apart(t, x, args):
    return x[0] - x[1]


def _at(rates):
    return lambda t, x, args: jnp.asarray(rates) + 0 * x


@pytest.mark.slow
def test_two_fields_that_point_at_each_other_slide():
    """https://github.com/OpenModelica/OpenModelica/issues/12190: events without end where x = y; the run gets stuck.

    Both rates there are −6/17, the convex combination that keeps x = y: x(1) = 17/14 − (6/17)(6/7) = 31/34.
    """
    slides = lh.filippov(_at(ABOVE), _at(BELOW), _apart)
    run = lh.trajectory(slides, [1.5, 1.0], t1=1.0)
    assert run.status is lh.STATUS.ok
    assert_allclose(run.events.t, [MET], rtol=1e-13)
    assert_allclose(run.x[-1], 31 / 34, rtol=1e-12)
    onto = np.eye(2) + np.outer(-6 / 17 - ABOVE, [1, -1]) / (ABOVE[0] - ABOVE[1])  # S, of rank 1
    spectrum = lh.lyapunov_spectrum(slides, [1.5, 1.0], t1=1.0)
    assert_allclose(spectrum.exponents, [np.log(np.linalg.norm(onto[:, 0])), -np.inf], rtol=1e-12)
    assert spectrum.notes == {"rank_lost"}


def test_two_modes_that_throw_the_state_to_each_other_end_at_once():
    """The same without sliding, as two modes: no run without end, but `zeno` at the time, with a finite cascade."""
    falls = lh.Transition(_apart, source="above", target="below", direction=-1)
    rises = lh.Transition(_apart, source="below", target="above", direction=+1)
    switches = lh.Hybrid({"above": _at(ABOVE), "below": _at(BELOW)}, [falls, rises])
    run = lh.trajectory(switches, [1.5, 1.0], t1=1.0, mode="above", throw=False)
    assert run.status is lh.STATUS.zeno
    assert len(run.events) < 100
    assert_allclose(run.events.t, MET, rtol=1e-12)


@pytest.mark.slow
def test_a_field_with_a_jump_is_not_stuck_on_it():
    """The same as one field with `where`: the run ends, and its message names the jump."""
    jumps = lh.Flow(lambda t, x, args: jnp.where(x[0] > x[1], ABOVE, BELOW))
    with pytest.raises(lh.RunFailedError, match="the field jumps .* give each smooth piece a mode") as caught:
        lh.trajectory(jumps, [1.5, 1.0], t1=1.0)
    assert caught.value.status is lh.STATUS.stalled
