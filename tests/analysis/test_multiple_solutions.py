"""Where a start has several solutions: all of them, each with its exact exponents."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

A, B = np.array([[2.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0], [1.0, 3.0]])


def gate(i, matrix, shift=0.0):
    """The clock x_i strikes at 1 and begins anew; w becomes matrix · w + shift."""

    def reset(t, x, args):
        return jnp.concatenate([(x[:2]).at[i].set(x[i] - 1.0), jnp.asarray(matrix) @ x[2:] + shift])

    return lh.Transition(lambda t, x, args: 1.0 - x[i], reset)


def clocks(*gates):
    return lh.Hybrid(lambda t, x, args: jnp.array([1.0, 1.0, 0.0, 0.0]), list(gates))


def growth(matrices):
    """ln R_ii of a product, by NumPy."""
    product = np.linalg.multi_dot([*reversed(matrices), np.eye(2)])
    return np.log(np.abs(np.diag(np.linalg.qr(product)[1])))


@pytest.fixture(scope="module")
def orders():
    return lh.solutions(clocks(gate(0, A), gate(1, B)), np.zeros(4), t1=3.5)


@pytest.mark.slow
def test_two_events_at_one_instant_whose_orders_give_different_saltation_matrices(orders):
    """Three instants: eight solutions, and their exponents are those of the eight products of AB and BA."""
    assert len(orders) == 8
    assert orders.complete
    wanted = {}
    for picks in itertools.product((0, 1), repeat=3):
        matrices = [m for pick in picks for m in ((A, B) if pick == 0 else (B, A))]
        wanted[picks] = np.sort(np.concatenate([growth(matrices), [0.0, 0.0]]))[::-1] / 3.5
    for one in orders.solutions:
        assert [choice.t for choice in one.choices] == pytest.approx([1.0, 2.0, 3.0], abs=1e-12)
        picks = tuple(choice.options.index(choice.taken) for choice in one.choices)
        assert_allclose(one.exponents, wanted.pop(picks), atol=1e-10)
        assert one.spectrum.status is lh.STATUS.ok
        assert "simultaneous" in one.spectrum.notes
    assert not wanted
    assert_allclose(orders.lower, orders.exponents.min(axis=0))
    assert_allclose(orders.upper, orders.exponents.max(axis=0))
    assert np.max(orders.upper - orders.lower) > 0.01


@pytest.mark.slow
def test_the_first_solution_is_the_one_that_is_found_without_asking(orders):
    alone = lh.lyapunov_spectrum(clocks(gate(0, A), gate(1, B)), np.zeros(4), t1=3.5)
    assert all(choice.taken == "event 1 first" for choice in orders.solutions[0].choices)
    assert_allclose(orders.solutions[0].exponents, alone.exponents, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_orders_that_do_not_matter_are_one_solution():
    found = lh.solutions(clocks(gate(0, np.diag([2.0, 1.0])), gate(1, np.diag([1.0, 3.0]))), np.zeros(4), t1=3.5)
    assert len(found) == 1
    assert found.complete
    assert found.solutions[0].choices == ()
    assert_allclose(found.exponents[0, :2], np.log([27.0, 8.0]) / 3.5, atol=1e-12)


@pytest.mark.slow
def test_orders_that_lead_to_different_states():
    """w → 2w and w → w + 1, from w = 1: 3 or 4."""
    system = clocks(gate(0, 2 * np.eye(2)), gate(1, np.eye(2), shift=1.0))
    found = lh.solutions(system, [0.0, 0.0, 1.0, 1.0], t1=1.5)
    assert sorted(float(one.spectrum.x[2]) for one in found.solutions) == pytest.approx([3.0, 4.0], abs=1e-12)


@pytest.mark.slow
def test_of_three_events_each_comes_first():
    def strike(i):
        return lh.Transition(lambda t, x, args: 1 - x[i], lambda t, x, args: x.at[i].set(0.0).at[3].set(10 * x[3] + i))

    system = lh.Hybrid(lambda t, x, args: jnp.array([1.0, 1.0, 1.0, 0.0]), [strike(i) for i in range(3)])
    found = lh.solutions(system, np.zeros(4), t1=1.5)
    assert [float(one.spectrum.x[3]) for one in found.solutions] == pytest.approx([12.0, 102.0, 201.0], abs=1e-9)


@pytest.mark.slow
def test_what_is_beyond_the_most_solutions_is_said():
    found = lh.solutions(clocks(gate(0, A), gate(1, B)), np.zeros(4), t1=3.5, most=3)
    assert (len(found), found.complete) == (3, False)
    assert "3 solutions from one start (there are more)" in repr(found)
    assert "t = 3: event 2 first (of event 1 first, event 2 first)" in repr(found)


# --- surfaces that repel, and two-folds ----------------------------------------------------------------------------


def field(rate, away):
    """w' = rate · w, x' = 1 and z' = ±x: z = 0 attracts while x < 0, repels while x > 0; x = 0 is a two-fold."""
    return lambda t, x, args: jnp.stack([1 + 0 * x[0], away * x[0], rate * x[2]])


FOLD = lh.filippov(field(1.0, 1.0), field(-0.5, -1.0), lambda t, x, args: x[1])
ACROSS = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])  # along w and z


@pytest.fixture(scope="module")
def left():
    return lh.solutions(FOLD, [0.5, 0.0, 0.0], t1=4.0, departures=3, frame=ACROSS)


@pytest.mark.slow
def test_a_surface_that_repels_is_left_to_either_side_or_slid_on(left):
    """w' = w above, −w/2 below and so w/4 on the surface; beside it neighbours leave at once: +∞."""
    at_once = {one.choices[0].taken: one for one in left.solutions if len(one.choices) == 1}
    assert set(at_once) == {"plus", "minus", "sliding"}
    assert_allclose(at_once["plus"].exponents, [1, 0], atol=1e-9)
    assert_allclose(at_once["minus"].exponents, [0, -0.5], atol=1e-9)
    assert_allclose(at_once["sliding"].exponents, [np.inf, 0.25], atol=1e-9)
    assert not left.complete  # it may be left at any time


@pytest.mark.slow
def test_perturbations_within_a_surface_that_repels_stay_there():
    found = lh.solutions(FOLD, [0.5, 0.0, 0.0], t1=4.0, frame=ACROSS[:, :1])
    assert_allclose(found.exponents[:, 0], [1.0, -0.5, 0.25], atol=1e-9)
    assert_allclose([found.lower[0], found.upper[0]], [-0.5, 1.0], atol=1e-9)


@pytest.mark.slow
def test_a_surface_that_repels_is_left_at_later_times(left):
    """After 1 of 4 units of time, 2 and 3: the exponents of w fill the interval between those of never and at once."""
    later = {(one.choices[1].t, one.choices[1].taken): one for one in left.solutions if len(one.choices) == 2}
    assert len(left) == 9
    assert len(later) == 6
    for (t, side), one in later.items():
        wanted = (0.25 * t + (1.0 if side == "plus" else -0.5) * (4 - t)) / 4
        assert t == pytest.approx(round(t), abs=1e-12)
        assert np.min(np.abs(one.exponents - wanted)) < 1e-9


@pytest.mark.slow
def test_sliding_that_comes_to_a_two_fold_leaves_to_either_side():
    """Sliding for 1 with w' = w/4, then 10 with w or −w/2: the exponents of w are exact."""
    found = lh.solutions(FOLD, [-1.0, 0.0, 0.0], t1=11.0, frame=ACROSS)
    assert [choice.taken for one in found.solutions for choice in one.choices] == ["plus", "minus"]
    assert found.solutions[0].choices[0].t == pytest.approx(1.0, abs=1e-8)
    for one, after, end in zip(found.solutions, (1.0, -0.5), (50.0, -50.0), strict=True):
        assert np.min(np.abs(one.exponents - (0.25 + 10 * after) / 11)) < 1e-8
        assert float(one.spectrum.x[1]) == pytest.approx(end, rel=1e-6)
        assert one.spectrum.status is lh.STATUS.ok
    assert not found.complete  # along the surface the field is 0/0 there


@pytest.mark.slow
def test_a_two_fold_that_both_sides_come_back_to_is_no_way_out():
    """z' = −x above and x below: at x = 0 both curve back to z = 0, which attracts from there on: one solution."""
    into = lh.filippov(field(1.0, -1.0), field(-0.5, 1.0), lambda t, x, args: x[1])
    found = lh.solutions(into, [0.0, 0.0, 0.0], t1=1.0, frame=ACROSS)
    assert [one.choices for one in found.solutions] == [()]
    assert found.solutions[0].spectrum.status is lh.STATUS.ok
    assert np.min(np.abs(found.exponents - 0.25)) < 1e-5


def test_deadlock_is_a_solution_that_does_not_go_on():
    """At z = 0 no transition applies: the only solution ends there."""
    stuck = lh.Hybrid(
        lambda t, x, args: jnp.array([-1.0]), lh.Transition(lambda t, x, args: x[0], when=lambda t, x, args: False)
    )
    found = lh.solutions(stuck, [1.0], t1=2.0)
    assert len(found) == 1
    assert found.complete
    assert found.solutions[0].spectrum.status is lh.STATUS.deadlock
    assert float(found.solutions[0].spectrum.t) == pytest.approx(1.0)
    assert np.all(np.isnan(found.lower))
    assert "deadlock" in repr(found)


@pytest.mark.parametrize(
    ("system", "x0", "keywords", "says"),
    [
        (lh.Flow(lambda t, x, args: -x), [1.0], {}, "needs an lh.Hybrid with fields; got Flow"),
        (clocks(gate(0, A)), np.zeros((2, 4)), {}, "solutions follows one orbit: x0 must have shape"),
        (clocks(gate(0, A)), np.zeros(4), {"most": 0}, "most must be an integer of at least 1"),
        (clocks(gate(0, A)), np.zeros(4), {"departures": -1}, "departures must be an integer of at least 0"),
    ],
)
def test_bad_arguments(system, x0, keywords, says):
    with pytest.raises(ValueError, match=says):
        lh.solutions(system, x0, t1=1.0, **keywords)
