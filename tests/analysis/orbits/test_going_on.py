"""Branches and curves that go on: bit by bit those of one call; in wider ranges against closed forms."""

import functools
import pickle

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from examples import LOGISTIC
from interrupts import interrupted_at
from lyaphybrid import zoo
from lyaphybrid.analysis.continuation.equations import BranchEquations
from lyaphybrid.analysis.curves.equations import CurveEquations

CIRCLE = lh.Map(lambda n, x, p: x + 0.3 * (1 - p**2 - x**2))
CUBIC = lh.Map(lambda n, x, args: args["a"] + (1 + args["b"]) * x - x**3)
ARGS, RANGES = {"a": 0.0, "b": 0.75}, {"a": (-1.0, 1.0), "b": (-0.5, 1.0)}


def turn_of(args):
    return 2 * jnp.pi / args["omega"]


def fixed_points(**more):
    return lh.continuation(LOGISTIC, [0.6], 2.5, **{"over": {"args": (1.5, 3.6)}, "period": 1} | more)


@functools.cache
def special_of(branch, kind):
    """The first special of its kind on a branch, found once."""
    return branch().of_kind(kind)[0]


def two_cycle(**more):
    start = special_of(fixed_points, "period doubling")
    return lh.continuation(LOGISTIC, start, 2.5, over={"args": (1.5, 3.6)}, period=1, **more)


def circle(**more):
    return lh.continuation(CIRCLE, [1.0], 0.0, over={"args": (-2.0, 2.0)}, period=1, step=0.05, **more)


def cubic(**more):
    return lh.continuation(CUBIC, [0.9], ARGS, over={"a": (-1.0, 1.0)}, period=1, **more)


def folds(**more):
    return lh.bifurcation_curve(CUBIC, special_of(cubic, "fold"), ARGS, **{"over": RANGES, "period": 1} | more)


def swinging(**more):
    """An oscillator that hits a wall once a turn, until it no longer reaches it."""
    problem = zoo.impact_oscillator(omega=2.0, gap=1.0)
    how = {"over": {"amplitude": (0.01, 4.0)}, "period": turn_of, "step": 0.1}
    return lh.continuation(problem.system, [-0.3, 0.0], problem.args, **how | more)


def touches(**more):
    problem = zoo.impact_oscillator(omega=2.0, gap=1.0)
    over = {"amplitude": (0.01, 4.0), "omega": (0.4, 2.2)}
    return lh.bifurcation_curve(
        problem.system, special_of(swinging, "grazing"), problem.args, over=over, period=turn_of, step=0.1, **more
    )


FOLLOWED = {
    "branch": (fixed_points, BranchEquations),
    "from a doubling": (two_cycle, BranchEquations),
    "closed": (circle, BranchEquations),
    "impacts": (swinging, BranchEquations),
    "curve": (folds, CurveEquations),
    "curve of touches": (touches, CurveEquations),
}


def same(one, other):
    assert one.ends == other.ends
    for name in ("values", "x0", "period", "multipliers"):
        assert_array_equal(getattr(one, name), getattr(other, name))
    assert [special.title for special in one.specials] == [special.title for special in other.specials]


@pytest.mark.slow
@pytest.mark.parametrize("name", FOLLOWED)
def test_with_more_points_it_is_that_of_one_call(name):
    follow, _ = FOLLOWED[name]
    whole, short = follow(), follow(max_points=4)
    assert "max_points" in short.ends
    assert len(short.values) < len(whole.values)
    same(short.resume(max_points=7).resume(max_points=500), whole)
    assert len(short.values) <= 7  # the first one is as it was


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:interrupted")
@pytest.mark.parametrize("name", FOLLOWED)
def test_after_ctrl_c_it_goes_on(name):
    """Early, on the first side, and late, on the second one where there is one."""
    follow, equations = FOLLOWED[name]
    whole = follow()
    for call in (6, int(0.8 * len(whole.values))):
        with pytest.MonkeyPatch.context() as patch:
            interrupted_at(patch, equations, "corrected", call)
            short = follow()
        assert "interrupted" in short.ends
        assert len(short.values) < len(whole.values)
        same(short.resume(), whole)


@pytest.mark.slow
def test_in_a_wider_range_a_branch_keeps_its_closed_form():
    short = fixed_points(over={"args": (2.4, 2.6)})
    assert short.ends == ("range", "range")
    wide = short.resume(over={"args": (1.5, 3.6)})
    assert wide.ends == ("range", "range")
    assert (wide.values[0], wide.values[-1]) == (1.5, 3.6)
    assert_allclose(wide.x0[:, 0], 1 - 1 / wide.values, atol=1e-12)
    assert wide.of_kind("period doubling")[0].parameter == pytest.approx(3.0, abs=1e-11)
    assert set(short.values) <= set(wide.values)


@pytest.mark.slow
def test_in_wider_ranges_a_curve_keeps_its_closed_form():
    short = folds(over={"a": (-0.3, 0.3), "b": (-0.5, 1.0)})
    assert short.ends == ("range", "range")
    wide = short.resume(over=RANGES)
    a, b = wide.values.T
    assert_allclose(a**2, 4 * (b / 3) ** 3, atol=1e-12)
    assert (np.min(a), np.max(a)) == pytest.approx((-2 / 27**0.5, 2 / 27**0.5), abs=1e-12)
    assert np.max(b) == 1.0


@pytest.mark.slow
def test_a_branch_begins_at_the_last_orbit_of_another():
    """What a process that is gone has left: its last orbit, in a file, is the start; the way back is not followed."""
    first = pickle.loads(pickle.dumps(fixed_points(over={"args": (2.4, 2.6)})))
    with pytest.raises(ValueError, match="is a copy"):
        first.resume()
    end = float(first.values[-1])
    more = lh.continuation(LOGISTIC, first.x0[-1], end, over={"args": (end, 3.6)}, period=1)
    assert more.ends == ("range", "range")
    assert more.values[0] == end
    assert_allclose(more.x0[:, 0], 1 - 1 / more.values, atol=1e-12)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"max_points": 1}, "max_points"),
        ({"over": {"r": (1.0, 4.0)}}, "over must be the range of args"),
        ({"over": {"args": (2.0, 3.0)}}, "must hold that before"),
        ({"over": {"args": 2.0}}, "over must be"),
    ],
)
def test_a_branch_refuses_what_does_not_fit(how, words):
    with pytest.raises(ValueError, match=words):
        fixed_points().resume(**how)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("over", "words"),
    [({"a": (-2.0, 2.0)}, "ranges of a and b"), (RANGES | {"b": (0.0, 1.0)}, "range of b must hold that before")],
)
def test_a_curve_refuses_what_does_not_fit(over, words):
    with pytest.raises(ValueError, match=words):
        folds().resume(over=over)


def fractions(run):
    """What a progress function is told."""
    told: list[float] = []
    return run(told.append), told


@pytest.mark.parametrize("to", [3.2, 3.6])
def test_progress_of_a_branch(to):
    """The fixed point of the logistic map, followed to both ends; the reports rise, and end with all."""
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    over = {"args": (2.0, to)}
    branch, told = fractions(
        lambda progress: lh.continuation(logistic, [0.6], 2.5, over=over, period=1, progress=progress)
    )
    assert branch.ends == ("range", "range")
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert len(told) >= len(branch.values) - 1
    _, silent = fractions(lambda progress: branch.resume(over={"args": (1.9, to)}))
    assert silent == []


@pytest.mark.slow
def test_progress_of_a_curve():
    henon = lh.Map(lambda n, x, args: jnp.stack([1 - args["a"] * x[0] ** 2 + x[1], args["b"] * x[0]]))
    args = {"a": 0.3, "b": 0.3}
    branch = lh.continuation(henon, [0.9, 0.27], args, over={"a": (0.1, 0.6)}, period=1)
    (doubling,) = branch.of_kind("period doubling")
    over = {"a": (0.1, 0.6), "b": (0.1, 0.5)}
    curve, told = fractions(
        lambda progress: lh.bifurcation_curve(henon, doubling, args, over=over, period=1, progress=progress)
    )
    assert len(curve.values) > 3
    assert told == sorted(told)
    assert told[-1] == 1.0
