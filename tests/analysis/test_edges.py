"""Motions on the boundaries of basins: a fixed point of a map, a saddle, an unstable cycle with impacts."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from benchmarks.capabilities.basins import BALL, REPELS
from lyaphybrid.analysis.basins import edges, recognition, sampling
from lyaphybrid.analysis.basins.basins import BasinRun

CUBIC = lh.Map(lambda n, x, args: args * x - x**3)
WELLS = lh.Flow(lambda t, x, args: jnp.stack([x[1], x[0] - x[0] ** 3 - args * x[1]]), names=("x", "v"))
TURN = 2 * np.pi / 1.2


def driven(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.4 * x[1] + args * jnp.cos(1.2 * t)])


WALLED = lh.Hybrid(
    driven, lh.Transition(lambda t, x, args: 1.3 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
)


@pytest.mark.slow
def test_a_fixed_point_of_a_map():
    """x → ax − x³ from both sides of 0: the exponent ln a."""
    found = lh.basins(CUBIC, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    edge = lh.edge_state(CUBIC, found, 1.7, t1=200, settle=300)
    assert_allclose(edge.x, 0.0, atol=1e-4)
    assert edge.rate == pytest.approx(np.log(1.7), abs=1e-6)
    assert edge.rounds > 3
    assert edge.t[-1] >= 200


@pytest.mark.slow
def test_a_saddle_between_two_wells():
    found = lh.basins(WELLS, [[-2.0, -1.0], [2.0, 1.0]], 0.5, shape=(20, 10), t1=80.0)
    edge = lh.edge_state(WELLS, found, 0.5, t1=80.0, settle=80.0)
    late = edge.t > 40
    assert_allclose(edge.x[late], 0.0, atol=1e-3)
    growing = (-0.5 + np.sqrt(0.25 + 4)) / 2
    assert edge.rate == pytest.approx(growing, abs=1e-4)


@pytest.mark.parametrize("settle", [60.0, 3000.0])
def test_a_generous_time_to_settle_changes_nothing(settle):
    """X' = x − x³ + 0.1 between its wells: the rate 1 − 3x² at the middle rest, however far apart samples would be."""
    tilted = lh.Flow(lambda t, x, args: x - x**3 + 0.1)
    found = lh.basins(tilted, [[-1.5], [1.5]], shape=(50,), t1=60.0)
    edge = lh.edge_state(tilted, found, t1=20.0, settle=settle)
    middle = np.sort(np.roots([-1, 0, 1, 0.1]).real)[1]
    assert edge.rate == pytest.approx(1 - 3 * middle**2, abs=1e-4)
    assert_allclose(edge.x[-1], middle, atol=1e-4)
    assert_array_equal(edge.resume(60.0).x, lh.edge_state(tilted, found, t1=60.0, settle=settle).x)


def test_a_pair_that_parts_within_a_period_is_refused():
    steep = lh.Map(lambda n, x, args: jnp.clip(1e8 * x, -1.0, 1.0))
    found = lh.basins(steep, [[-1.3], [1.2]], shape=(50,), t1=100)
    with pytest.raises(ValueError, match="part within one period"):
        lh.edge_state(steep, found, t1=10, settle=20)


@pytest.mark.slow
def test_an_unstable_cycle_beside_a_wall():
    """From its end `floquet` finds the cycle, whose multiplier is what the pair parted by."""
    found = lh.basins(WALLED, [[-1.6, -1.0], [1.2, 1.0]], 0.1, shape=(24, 24), t1=40 * TURN, period=TURN)
    assert len(found.attractors) >= 2
    edge = lh.edge_state(WALLED, found, 0.1, t1=40 * TURN, settle=60 * TURN, period=TURN)
    orbit = lh.floquet(WALLED, edge.x[-1], 0.1, t0=0.0, period=TURN)
    assert orbit.status == lh.STATUS.ok
    assert np.min(np.linalg.norm(np.asarray(orbit.x0) - edge.x[edge.t > 20 * TURN], axis=1)) < 1e-2
    assert edge.rate == pytest.approx(float(np.max(orbit.exponents)), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("settle", [311.7, 400.0])
def test_an_impact_within_a_mode_parts_nobody(settle):
    """The bounce of speed 1 repels, by 1.3 in the time 2.

    With settle = 400 samples fall onto impacts, where one motion of the pair has jumped and the other has not.
    """
    found = lh.basins(BALL, [[0.107, 0.0], [1.2, 0.0]], shape=(110,), t1=60.0)
    edge = lh.edge_state(BALL, found, t1=300.0, settle=settle)
    np.testing.assert_allclose(edge.x[:, 0] + edge.x[:, 1] ** 2 / 2, 0.5, atol=1e-3)
    assert edge.rate == pytest.approx(np.log(REPELS) / 2, abs=3e-3)


def test_it_prints_and_becomes_a_dataset():
    found = lh.basins(CUBIC, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    edge = lh.edge_state(CUBIC, found, 1.7, t1=50, settle=300)
    assert "part at the rate 0.53" in str(edge)
    data = edge.to_xarray()
    assert data["x"].dims == ("t", "state")
    assert data.attrs["rounds"] == edge.rounds


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"between": (0, 0)}, "two of the 2 attractors"),
        ({"between": (0, 7)}, "two of the 2 attractors"),
        ({"found": 3}, "must be a Basins"),
        ({"settle": 0.0}, "settle, a length"),
        ({"t1": -1}, "t1, a length"),
        ({"settle": 1}, "something else"),
    ],
)
def test_what_cannot_be_is_refused(change, words):
    found = lh.basins(CUBIC, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    how = {"found": found, "t1": 50, "settle": 300} | change
    with pytest.raises(ValueError, match=words):
        lh.edge_state(CUBIC, how.pop("found"), 1.7, **how)


def same_edge(one, other):
    assert one.rounds == other.rounds
    for name in ("t", "x", "modes", "rate", "stderr"):
        assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.slow
def test_a_motion_that_goes_on_is_that_of_one_call():
    found = lh.basins(CUBIC, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    whole = lh.edge_state(CUBIC, found, 1.7, t1=300, settle=300)
    short = lh.edge_state(CUBIC, found, 1.7, t1=60, settle=300)
    assert short.rounds < whole.rounds
    same_edge(short.resume(150).resume(300), whole)
    with pytest.raises(ValueError, match="beyond the"):
        whole.resume(200)
    with pytest.raises(ValueError, match="is a copy"):
        dataclasses.replace(short).resume(300)


@pytest.mark.slow
def test_a_driven_motion_with_impacts_goes_on_too():
    found = lh.basins(WALLED, [[-1.6, -1.0], [1.2, 1.0]], 0.1, shape=(24, 24), t1=40 * TURN, period=TURN)
    how = {"settle": 60 * TURN, "period": TURN}
    short = lh.edge_state(WALLED, found, 0.1, t1=5 * TURN, **how)
    same_edge(short.resume(20 * TURN), lh.edge_state(WALLED, found, 0.1, t1=20 * TURN, **how))


def test_ctrl_c_keeps_the_motion_until_then_and_it_goes_on(monkeypatch):
    found = lh.basins(CUBIC, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    whole, run, calls = lh.edge_state(CUBIC, found, 1.7, t1=300, settle=300), sampling.map_lanes, []

    def stopped(*given, **how):
        calls.append(given)
        results, done = run(*given, **how)
        return results, done & (len(calls) != 60)

    monkeypatch.setattr(sampling, "map_lanes", stopped)
    with pytest.warns(UserWarning, match="resume goes on"):
        short = lh.edge_state(CUBIC, found, 1.7, t1=300, settle=300)
    assert 0 < short.rounds < whole.rounds
    same_edge(short.resume(300), whole)


TILTED = lh.Flow(lambda t, x, args: x - x**3 + args["tilt"])


@pytest.mark.slow
def test_shares_along_a_parameter_are_those_of_the_middle_fixed_point():
    """x' = x − x³ + a: what begins above the middle root goes up; beyond a = 2/√27 one well is left."""
    values = np.array([-0.3, 0.0, 0.2, 0.35, 0.45])
    how = {"over": {"tilt": values}, "t1": 80.0, "starts": 2000, "key": jax.random.key(5)}
    found = lh.basin_shares(TILTED, [[-1.5], [1.5]], {"tilt": 0.0}, **how)
    assert found.names == ("attractor 0", "attractor 1")
    first = found.basins[0].attractors
    up = int(np.argmax([one.points[0, 0] for one in first]))
    for row, error, a in zip(found.shares, found.stderr, values, strict=True):
        real = np.sort([root.real for root in np.roots([-1, 0, 1, a]) if abs(root.imag) < 1e-9])
        exact = (1.5 - real[1]) / 3 if len(real) == 3 else 1.0
        assert abs(row[up] - exact) <= 4 * error[up]
        assert np.sum(row) == pytest.approx(1.0)
    data = found.to_xarray()
    assert data["shares"].dims == ("tilt", "class")
    assert "attractor 1" in str(found)
    ax = found.plot()
    assert ax.get_xlabel() == "tilt"


@pytest.mark.slow
def test_attractors_that_move_farther_than_they_are_apart_in_a_component():
    """The second component is nearly the same for both, and moves with the parameter: a point of each leads to it."""
    both = lh.Map(lambda n, x, p: jnp.stack([x[0] + 0.2 * (x[0] - x[0] ** 3), 0.5 * x[1] + p["a"] + 0.005 * x[0]]))
    how = {"over": {"a": np.linspace(0.0, 1.0, 5)}, "t1": 200, "starts": 500, "key": jax.random.key(2)}
    found = lh.basin_shares(both, [[-1.5, -1.0], [1.5, 1.0]], {"a": 0.0}, **how)
    assert found.names == ("attractor 0", "attractor 1")
    for each in found.basins:
        assert {float(np.sign(one.points[0, 0])) for one in each.attractors} == {-1.0, 1.0}
    assert_allclose(found.shares, np.broadcast_to(found.shares[0], found.shares.shape), atol=1e-12)


@pytest.mark.slow
def test_what_is_no_attractor_has_its_share_too():
    """x' = ax + x³ escapes from beyond √−a."""
    runs_away = lh.Flow(lambda t, x, args: args["a"] * x + x**3)
    how = {"over": {"a": [-1.0, -0.25]}, "t1": 100.0, "starts": 1000, "key": jax.random.key(1)}
    found = lh.basin_shares(runs_away, [[0.0], [2.0]], {"a": 0.0}, **how)
    assert found.names[0] == "attractor 0"
    assert len(found.names) == 2
    assert np.all(np.abs(found.shares[:, 0] - [0.5, 0.25]) < 4 * found.stderr[:, 0])


@pytest.mark.parametrize(
    ("change", "words"),
    [({"over": {"lean": [0.0]}}, "lean"), ({"over": [0.0]}, "over must be a dictionary"), ({"t1": 0}, "t1, a length")],
)
def test_shares_refuse_what_does_not_fit(change, words):
    how = {"over": {"tilt": [0.0]}, "t1": 80.0, "starts": 20, "key": jax.random.key(5)} | change
    with pytest.raises((ValueError, TypeError), match=words):
        lh.basin_shares(TILTED, [[-1.5], [1.5]], {"tilt": 0.0}, **how)


@pytest.mark.slow
def test_ctrl_c_keeps_the_values_before_it(monkeypatch):
    """`basins` says that it was interrupted; then no further value is begun."""
    asked, found_by = [], BasinRun.found

    def once(run, steps, progress=None):
        asked.append(run.sampling.args["tilt"])
        steps.interrupted = len(asked) >= 2
        return found_by(run, steps, progress)

    monkeypatch.setattr(BasinRun, "found", once)
    how = {"t1": 60.0, "starts": 50, "key": jax.random.key(0)}
    with pytest.warns(UserWarning, match="1 of 3 values"):
        found = lh.basin_shares(TILTED, [[-1.5], [1.5]], {"tilt": 0.0}, over={"tilt": [0.0, 0.1, 0.2]}, **how)
    assert asked == [0.0, 0.1]
    assert found.values.tolist() == [0.0]
    with pytest.raises(KeyboardInterrupt):
        lh.basin_shares(TILTED, [[-1.5], [1.5]], {"tilt": 0.0}, over={"tilt": [0.0, 0.1, 0.2]}, **how)


def test_ctrl_c_ends_the_motion_on_an_edge(monkeypatch):
    found = lh.basins(CUBIC, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    run = sampling.map_lanes

    def stopped(*given, **how):
        results, done = run(*given, **how)
        return results, np.zeros_like(done)

    monkeypatch.setattr(sampling, "map_lanes", stopped)
    with pytest.raises(KeyboardInterrupt):
        lh.edge_state(CUBIC, found, 1.7, t1=50, settle=300)


def test_a_pair_far_from_zero_is_as_near_as_floats_can_be():
    """Near 1e9 two floats are 1e-7 apart, more than a pair should be."""
    pair = edges._Straddling(0.0, None, np.array([[1e9 - 1.0], [1e9 + 1.0]]))
    metric = recognition.Metric(np.array([1.0]), ())
    near = edges._together(pair, (0, 1), lambda t, mode, rows: (rows[:, 0] > 1e9 + 0.3).astype(int), metric)
    assert near.x[0, 0] <= 1e9 + 0.3 < near.x[1, 0]
    assert near.x[1, 0] == np.nextafter(near.x[0, 0], np.inf)


def test_a_start_between_that_is_on_the_boundary():
    """By symmetry the middle of the first pair is the edge state itself, the fixed point 0, and never leaves it."""
    cubic = lh.Map(lambda n, x, args: 1.5 * x - x**3)
    found = lh.basins(cubic, [[-1.25], [1.25]], shape=(50,), t1=100)
    assert_allclose(lh.edge_state(cubic, found, t1=100, settle=200).rate, np.log(1.5), rtol=1e-7)
