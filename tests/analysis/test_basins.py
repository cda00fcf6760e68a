"""Basins: exact shares, symmetries, a Cantor set as boundary, chaos beside a cycle, runs that end otherwise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from benchmarks.capabilities.basins import gap, newton
from lyaphybrid.analysis.basins import measures
from lyaphybrid.analysis.basins.recognition import Attractor, Metric, arrived

KEY = jax.random.key(0)
WELLS = lh.Flow(lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - 0.5 * x[1]]), names=("x", "v"))


def double_well(t, x, a):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.15 * x[1] + 0.15 * jnp.cos(1.2 * t)])


WALLED = lh.Hybrid(
    double_well,
    lh.Transition(lambda t, x, a: 1.25 - x[0], lambda t, x, a: jnp.stack([x[0], -0.8 * x[1]])),
    names=("x", "v"),
)


def of_walled(method, shape=(14, 14)):
    turn = 2 * np.pi / 1.2
    return lh.basins(WALLED, [[-2.0, -2.0], [1.25, 2.0]], shape=shape, t1=40 * turn, period=turn, method=method)


@pytest.mark.slow
def test_two_wells_share_a_symmetric_box():
    found = lh.basins(WELLS, [[-2.0, -1.0], [2.0, 1.0]], shape=(20, 10), t1=80.0)
    assert found.shares.tolist() == [0.5, 0.5]
    assert np.array_equal(found.labels, 1 - found.labels[::-1, ::-1])
    assert sorted(round(float(one.points[0, 0]), 9) for one in found.attractors) == [-1.0, 1.0]


@pytest.mark.slow
def test_newton_s_basins_have_the_symmetries_of_the_roots():
    box = [[-1.0, -1.0], [1.0, 1.0]]
    found = lh.basins(lh.Map(newton), box, shape=(128, 128), t1=60)
    right = found.labels[np.argmin(np.abs(found.axes[0] - 1)), 64]
    mirrored = found.labels[:, ::-1]
    assert np.array_equal(found.labels == right, mirrored == right)
    assert len(found.attractors) == 3
    of_some = lh.basins(lh.Map(newton), box, starts=3000, key=KEY, t1=60)
    assert np.all(np.abs(of_some.shares - 1 / 3) < 5 * of_some.stderr)
    assert_allclose(of_some.stderr, np.sqrt(of_some.shares * (1 - of_some.shares) / 3000))


def test_a_boundary_is_a_cantor_set():
    found = lh.basins(lh.Map(gap), [[0.0], [1.0]], shape=(2**13,), t1=60)
    assert_allclose(found.shares, 0.5, atol=0.01)
    dimension = found.boundary_dimension()
    assert abs(dimension.dimension - np.log(2) / np.log(3)) < 0.03
    assert dimension.stderr < 0.04


def test_a_smooth_boundary_has_one_dimension_less():
    found = lh.basins(WELLS, [[-1.0, -1.0], [1.0, 1.0]], shape=(128, 128), t1=80.0)
    dimension = found.boundary_dimension()
    assert abs(dimension.dimension - 1) < 3 * dimension.stderr < 0.06


def skewed(n, x, args):
    """θ' = 2θ, z' = az + cos θ, and far away one point above and one below. Between them stays a Weierstrass graph."""
    angle, z = x
    after = args * z + jnp.cos(angle)
    far = jnp.abs(after) > 20
    return jnp.stack([jnp.where(far, 0, 2 * angle % (2 * jnp.pi)), jnp.where(far, 25 * jnp.sign(after), after)])


@pytest.mark.slow_cases(all_but=("1.5",))
@pytest.mark.parametrize("a", [1.5, 1.2])
def test_a_boundary_is_the_graph_of_a_weierstrass_function(a):
    """Of dimension 2 − ln a/ln 2 (McDonald et al. 1985); vertical lines cross it once, horizontal ones everywhere."""
    n = 300
    found = lh.basins(lh.Map(skewed), [[0.0, -3.0], [2 * np.pi, 3.0]], a, shape=(n, n), t1=80)
    angle, z = (np.asarray(found.axes[i]) for i in (0, 1))
    graph = -sum(a ** -(k + 1.0) * np.cos(2.0**k * angle % (2 * np.pi)) for k in range(60))
    above = np.array([one.points[0, 1] > 0 for one in found.attractors])
    assert np.mean(above[found.labels] != (z > graph[:, None])) < 1e-3
    dimension = found.boundary_dimension()
    assert abs(dimension.dimension - 2 + np.log(a) / np.log(2)) < 3 * dimension.stderr < 0.1


@pytest.mark.parametrize(("d", "n"), [(1, 2000), (2, 200), (3, 64)])
def test_dimensions_of_known_sets(d, n):
    """A smooth surface has d − 1, noise has d; and a line along an axis, which that axis never crosses."""
    rng = np.random.default_rng(d)
    ball = sum(np.meshgrid(*[np.linspace(-1, 1, n) ** 2] * d)) < 0.6
    for labels, known in ((ball, d - 1), (rng.integers(0, 2, (n,) * d), d), (np.indices((n,) * d)[0] > n / 3, d - 1)):
        found = measures.boundary_dimension(labels.astype(int))
        assert abs(found.dimension - known) < 3 * found.stderr + 1e-12
        assert found.stderr < 0.1


@pytest.mark.slow
def test_chaos_beside_a_cycle_and_a_rerun_at_tighter_tolerance():
    loose = of_walled(lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9))
    assert sorted(one.period > 0 for one in loose.attractors) == [False, True]
    assert np.min(loose.shares[:2]) > 0.3
    tight = of_walled(lh.RungeKutta("dopri5", rtol=1e-9, atol=1e-11))
    assert np.mean(loose.labels != tight.labels) < 0.01  # starts within rounding of a fractal boundary
    cycle = next(one for one in loose.attractors if one.period)
    turn = 2 * np.pi / 1.2
    orbit = lh.floquet(WALLED, cycle.points[0], period=turn * cycle.period)
    assert_allclose(orbit.x0, cycle.points[0], rtol=0, atol=1e-4)


@pytest.mark.slow
def test_a_turning_pendulum_is_an_attractor_beside_rest():
    pendulum = lh.Flow(lambda t, x, a: jnp.stack([x[1], 0.6 - jnp.sin(x[0]) - 0.3 * x[1]]), names=("angle", "speed"))
    found = lh.basins(pendulum, [[-3.0, -4.0], [3.0, 4.0]], shape=(16, 16), t1=100.0, angles=[0])
    assert sorted(one.period for one in found.attractors) == [0, 1]
    turning = next(one for one in found.attractors if not one.period)
    assert np.min(turning.points[:, 1]) > 0.5
    for one in found.attractors:  # angles are those of one turn
        assert np.all((one.points[:, 0] > -np.pi) & (one.points[:, 0] <= np.pi))


@pytest.mark.slow
def test_runs_that_end_otherwise_are_classes_of_their_own():
    ball = lh.Hybrid(
        lambda t, x, a: jnp.stack([x[1], 0 * x[1] - 1.0]),
        lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], -0.5 * x[1]])),
    )
    assert lh.basins(ball, [[0.1, 0.0], [1.0, 0.1]], starts=20, key=KEY, t1=20.0).names == ("zeno",)
    escaping = lh.basins(lh.Map(lambda n, x, a: x**2), [[0.0], [2.0]], shape=(64,), t1=40)
    assert escaping.names == ("attractor 0", "nonfinite")
    assert escaping.shares.tolist() == [0.5, 0.5]


@pytest.mark.slow
def test_slow_motions_are_undecided_and_later_found():
    slow = lh.Flow(lambda t, x, a: -0.02 * x)
    found = lh.basins(slow, [[-1.0], [1.0]], shape=(32,), t1=100.0)
    assert found.names == ("attractor 0",)
    assert found.shares.tolist() == [1.0]


@pytest.mark.slow
@pytest.mark.parametrize("e", [0.1, 0.01])
def test_two_cycles_near_each_other(e):
    """r' = −(r − 1)(r − 1 − e/2)(r − 1 − e)/e²: starts within 1 + e/2 go to 1, all others to 1 + e."""

    def field(t, x, e):
        r = jnp.hypot(x[0], x[1])
        return -(r - 1) * (r - 1 - e / 2) * (r - 1 - e) / e**2 / r * x + jnp.stack([-x[1], x[0]])

    found = lh.basins(lh.Flow(field), [[-2.0, -2.0], [2.0, 2.0]], e, shape=(20, 20), t1=100.0)
    radii = [np.hypot(*one.points.T) for one in found.attractors]
    assert_allclose(sorted(np.mean(one) for one in radii), [1.0, 1 + e], atol=1e-6)
    inner = int(np.argmin([np.mean(one) for one in radii]))
    assert np.array_equal(found.labels.ravel() == inner, np.hypot(*found.starts.T) < 1 + e / 2)


@pytest.mark.slow
def test_a_cycle_whose_period_is_the_time_between_samples():
    clock = lh.Flow(lambda t, x, a: x * (1 - x @ x) + 2 * np.pi * jnp.stack([-x[1], x[0]]))
    found = lh.basins(clock, [[-2.0, -2.0], [2.0, 2.0]], shape=(10, 10), t1=64.0)
    assert found.names == ("attractor 0",)
    assert found.attractors[0].period == 0
    angles = np.sort(np.arctan2(*found.attractors[0].points.T))
    assert np.max(np.diff(angles)) < 0.1  # it is seen all round


@pytest.mark.slow
def test_two_equilibria_near_each_other():
    cubic = lh.Flow(lambda t, x, d: -x * (x - d) * (x - 2 * d) / d**2)
    found = lh.basins(cubic, [[-1.0], [1.0]], 1e-4, shape=(50,), t1=60.0)
    assert found.shares.tolist() == [0.5, 0.5]
    assert_allclose(sorted(float(one.points[0, 0]) for one in found.attractors), [0.0, 2e-4], atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "box", "args", "shape", "t1"),
    [
        (lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - a * x[1]]), [[-2.0, -2.0], [2.0, 2.0]], 1e-3, (8, 8), 200),
        (lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - a * x[1]]), [[-2.0, -2.0], [2.0, 2.0]], 1e-2, (8, 8), 100),
        (lambda t, x, a: -(x**3), [[-1.0], [1.0]], None, (20,), 100),
    ],
    ids=["hardly damped", "weakly damped", "algebraic"],
)
def test_what_has_not_settled_is_undecided(system, box, args, shape, t1):
    """The motions are on their way to the bottom of a well, and draw rings; or to 0 like 1/√t."""
    found = lh.basins(lh.Flow(system), box, args, shape=shape, t1=float(t1))
    assert found.names == ("undecided",)


def test_a_doubling_at_its_point_is_undecided():
    """At r = 3 motions of the logistic map settle like 1/√n, on both sides in turn."""
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    assert lh.basins(logistic, [[0.01], [0.99]], 3.0, shape=(50,), t1=200).names == ("undecided",)


@pytest.mark.slow
def test_chaos_in_four_bands_is_one_attractor():
    """The current of a converter, slopes 1 and −13/11."""

    def current(n, i, args):
        return jnp.where(5.0 - i >= 5.5, i + 5.5, 5.0 - 6.5 * (1 - (5.0 - i) / 5.5))

    found = lh.basins(lh.Map(current), [[2.0], [4.9]], shape=(40,), t1=100)
    assert found.names == ("attractor 0",)
    assert found.attractors[0].period == 0


@pytest.mark.slow
def test_starts_on_a_smaller_torus_stay_there():
    """Two clocks side by side; where one stands at its centre there are cycles, and a point where both do."""

    def clocks(t, x, a):
        turned = jnp.stack([-x[1], x[0], -a * x[3], a * x[2]])
        sizes = jnp.stack([x[0] ** 2 + x[1] ** 2, x[2] ** 2 + x[3] ** 2])
        return x * (1 - jnp.repeat(sizes, 2, total_repeat_length=4)) + turned

    found = lh.basins(lh.Flow(clocks), [[-2.0] * 4, [2.0] * 4], 2**0.5, shape=(3, 3, 3, 3), t1=60.0)
    assert sorted(np.round(found.shares * 81).astype(int)) == [1, 8, 8, 64]


def turning(n, x, args):
    """Turns by nearly a seventh; distances from the centre go to 1 from below √2, to √3 from above."""
    size = jnp.sqrt(jnp.sum(x**2))
    change = 1 + 0.05 * (1 - size**2) * (2 - size**2) * (3 - size**2) * args["pull"]
    c, s = jnp.cos(2 * jnp.pi * args["turn"]), jnp.sin(2 * jnp.pi * args["turn"])
    return change * jnp.stack([c * x[0] - s * x[1], s * x[0] + c * x[1]])


@pytest.mark.parametrize("key", [0, 1, 2])
def test_a_motion_that_nearly_repeats_is_one_attractor(key):
    """Four hundred samples leave gaps on the circle, each start its own; shares are those of a disk, exactly."""
    args = {"turn": 1 / 7 + 2.3e-4, "pull": 1.0}
    found = lh.basins(lh.Map(turning), [[0.1, 0.1], [1.4, 1.4]], args, t1=300, starts=400, key=jax.random.key(key))
    assert found.names == ("attractor 0", "attractor 1")
    inner = int(np.argmin([np.mean(np.hypot(*one.points.T)) for one in found.attractors]))
    starts = np.hypot(*np.asarray(found.starts).T)
    assert np.array_equal(np.asarray(found.labels) == inner, starts < np.sqrt(2))


def test_entropies_of_boxes_in_closed_form():
    labels = np.zeros((12, 12), int)
    labels[:, 4:] = 1  # boxes of 3: columns 3 … 5 are mixed, one third and two thirds
    found = measures.entropy(labels, 3)
    mixed = -(np.log(1 / 3) + 2 * np.log(2 / 3)) / 3
    assert_allclose(found.boundary, mixed, rtol=1e-12)
    assert_allclose(found.all, mixed / 4, rtol=1e-12)
    assert found.boundary_stderr < 1e-12


@pytest.mark.slow
def test_it_says_what_it_found():
    found = of_walled(lh.RungeKutta("dopri5", rtol=1e-6, atol=1e-8), shape=(6, 6))
    assert "does not repeat" in str(found)
    data = found.to_xarray()
    assert data.labels.dims == ("x", "v")
    assert_allclose(float(data.shares.sum()), 1.0)


@pytest.mark.slow_cases("<lambda>-needs starts on a grid")
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: lh.basins(WELLS, [[0.0, 0.0], [1.0, 1.0]], t1=9.0), "Give one of shape"),
        (lambda: lh.basins(WELLS, [0.0, 1.0], t1=9.0, shape=(3, 3)), "two corners"),
        (lambda: lh.basins(WELLS, [[0.0, 0.0], [1.0, 1.0]], t1=9.0, shape=(3,)), "one number for each"),
        (lambda: lh.basins(WELLS, [[0.0, 0.0], [1.0, 1.0]], t1=9.0, starts=10), "starts needs key"),
        (lambda: lh.basins(WELLS, [[1.0, 1.0], [1.0, 1.0]], t1=9.0, shape=(3, 3)), "must differ"),
        (lambda: lh.basins(WELLS, [[0.0, 0.0], [1.0, 1.0]], t1=9.0, shape=(3, 3), angles=[2]), "angles"),
        (
            lambda: lh.basins(WELLS, [[0.0, 0.0], [1.0, 1.0]], t1=40.0, starts=9, key=KEY).entropy(),
            "needs starts on a grid",
        ),
        (
            lambda: lh.basins(WELLS, [[0.5, 0.0], [1.0, 0.1]], t1=40.0, shape=(6, 6)).boundary_dimension(),
            "at least 64 cells",
        ),
    ],
)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_motions_on_a_cycle_amid_a_wide_set_are_on_the_cycle():
    """Blocks that topple tumble for ever and spread: near each state there is a line through two of their points."""
    draw = np.random.default_rng(0)
    wide = Attractor(draw.uniform([-4000, -6], [2000, 6], (4000, 2)), np.zeros(4000, int), 0, 0.7)
    cycle = Attractor(np.array([[0.0123, 0.4341]]), np.zeros(1, int), 1, 1e-5)
    metric = Metric(np.array([6000.0, 12.0]), ())
    on_cycle = cycle.points + draw.uniform(-1e-6, 1e-6, (20, 8, 2))
    elsewhere = draw.uniform([-4000, -6], [2000, 6], (20, 8, 2))
    points = np.concatenate([on_cycle, elsewhere])
    found = arrived(points, np.zeros(points.shape[:2], int), metric, [cycle, wide])
    assert found.tolist() == [0] * 20 + [1] * 20
