"""Filippov systems: crossing, sliding, sticking, against closed forms and differences of the flow itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid.statuses import STATUS

METHOD = lh.RungeKutta("rk4", dt=0.01)


def towards(direction):
    """A block (x, v) on a rough table, pulled by sin t."""
    return lambda t, x, args: jnp.stack([x[1], jnp.sin(t) - direction * args["kinetic"]])


def velocity(t, x, args):
    return x[1]


def margins(t, x, args):
    return jnp.stack([args["static"] - jnp.sin(t), args["static"] + jnp.sin(t)])


def rest(t, x, args):
    return 0 * x


BLOCK = lh.filippov(towards(1.0), towards(-1.0), velocity)
STICKY = lh.filippov(towards(1.0), towards(-1.0), velocity, sliding=rest, stick=margins)
ARGS = {"kinetic": 0.6, "static": 0.8}


def linear(matrix, offset):
    return lambda t, x, args: jnp.asarray(matrix) @ x + jnp.asarray(offset)


# What is built.


def test_modes_of_one_surface_and_of_several():
    assert BLOCK.mode_names == ("plus", "minus", "sliding")
    left, middle, right = (linear(np.zeros((2, 2)), (v, 0.0)) for v in (1.0, 0.0, -1.0))
    several = lh.filippov([middle, right], [left, middle], [lambda t, x, a: x[0] + 1, lambda t, x, a: x[0] - 1])
    assert several.mode_names == ("region0", "region1", "region2", "sliding0", "sliding1")
    assert several.fields[0] is middle
    assert [tr.source for tr in several.transitions[:2]] == [("region0",), ("region1",)]


def test_a_slide_that_meets_another_surface_ends():
    """x' = −sgn x, y' = −sgn y from (0.5, 1.2): on x = 0 from t = 0.5, at the origin, where both slide, at t = 1.2."""

    def quadrant(sx, sy):
        return lambda t, x, args: jnp.stack([-sx + 0.0 * x[0], -sy + 0.0 * x[1]])

    right, left, below, opposite = quadrant(1, 1), quadrant(-1, 1), quadrant(1, -1), quadrant(-1, -1)
    x, y = (lambda t, x, a: x[0]), (lambda t, x, a: x[1])
    crossing = lh.filippov([right, below, right, left], [left, opposite, below, opposite], [x, x, y, y])
    run = lh.trajectory(crossing, [0.5, 1.2], t1=5.0, throw=False)
    assert run.status == lh.STATUS.deadlock
    ends = lh.lyapunov_spectrum(crossing, [0.5, 1.2], t1=5.0, throw=False)
    assert abs(float(ends.t) - 1.2) < 1e-9
    assert float(np.max(np.abs(ends.x))) < 1e-9


def test_a_slide_that_comes_close_to_another_surface_goes_on():
    """x' = ∓1, y' = −y: on x = 0 from t = 0.5, and y = exp(−t) never reaches the surface y = 0."""
    right = lambda t, x, a: jnp.stack([1.0 + 0 * x[0], -x[1]])  # noqa: E731
    left = lambda t, x, a: jnp.stack([-1.0 + 0 * x[0], -x[1]])  # noqa: E731
    below = lambda t, x, a: jnp.stack([0 * x[0], -1.0 + 0 * x[0]])  # noqa: E731
    system = lh.filippov([left, left], [right, below], [lambda t, x, a: x[0], lambda t, x, a: x[1]])
    run = lh.trajectory(system, [-0.5, 1.0], t1=60.0, n=2)
    assert len(run.events) == 1
    assert run.status == lh.STATUS.ok


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((1.0, rest, velocity), "plus must be a function of"),
        ((rest, rest, None), "surface must be a function of"),
        (([rest], rest, [velocity]), "minus must be a sequence with one entry for each of the 1"),
        (([rest], [rest, rest], [velocity]), "minus must be a sequence"),
    ],
)
def test_bad_arguments_say_what_was_wanted(arguments, says):
    with pytest.raises(ValueError, match=says):
        lh.filippov(*arguments)


def test_a_stick_set_without_margins_says_what_to_write():
    system = lh.filippov(towards(1.0), towards(-1.0), velocity, stick=lambda t, x, a: jnp.abs(jnp.sin(t)) <= 0.8)
    with pytest.raises(ValueError, match="smooth numbers that are positive while the motion sticks"):
        lh.trajectory(system, [0.0, 0.0], ARGS, t1=1.0)


# Where a run begins.


@pytest.mark.parametrize(
    ("x0", "t0", "mode"),
    [
        ((0.0, 0.1), 0.0, 0),
        ((0.0, -0.1), 0.0, 1),
        ((0.0, 0.0), 0.0, 2),
        ((0.0, 0.0), np.pi / 2, 0),  # pulled by 1 > 0.6
        ((0.0, 0.0), -np.pi / 2, 1),
    ],
)
def test_a_start_says_in_which_mode_it_is(x0, t0, mode):
    assert int(BLOCK.initial_mode(jnp.asarray(t0), jnp.asarray(x0), ARGS)) == mode


def test_stiction_holds_a_start_that_kinetic_friction_would_not():
    t = jnp.asarray(np.arcsin(0.7))
    assert int(BLOCK.initial_mode(t, jnp.zeros(2), ARGS)) == 0
    assert int(STICKY.initial_mode(t, jnp.zeros(2), ARGS)) == 2


@pytest.mark.slow
def test_a_start_where_both_fields_point_away_is_a_deadlock():
    repelling = lh.filippov(linear(np.zeros((2, 2)), (0.0, 1.0)), linear(np.zeros((2, 2)), (0.0, -1.0)), velocity)
    run = lh.trajectory(repelling, [0.3, 0.0], t1=1.0, n=4, method=METHOD, throw=False)
    assert run.status is STATUS.deadlock
    assert np.isnan(run.x).all()
    with pytest.raises(lh.RunFailedError, match="repelling sliding"):
        lh.lyapunov_spectrum(repelling, [0.3, 0.0], t1=1.0, method=METHOD)


@pytest.mark.slow
def test_sliding_that_ends_in_a_two_fold_is_a_deadlock():
    """z' = ±x, x' = 1: the surface z = 0 attracts while x < 0 and repels from x = 0 on, where both are tangent."""

    def field(sign):
        return lambda t, x, args: jnp.stack([1 + 0 * x[0], sign * x[0]])

    system = lh.filippov(field(1.0), field(-1.0), velocity)
    run = lh.trajectory(system, [-1.0, 0.0], t1=2.0, n=4, method=METHOD, throw=False)
    assert run.status is STATUS.deadlock
    assert np.array_equal(run.mode[:1], [2])
    assert np.isfinite(run.x[:1]).all()
    assert np.isnan(run.x[2:]).all()


# Motion.


@pytest.mark.slow
def test_a_block_leaves_rest_when_the_pull_exceeds_friction():
    run = lh.trajectory(BLOCK, [0.0, 0.0], ARGS, t1=2.0, n=50, method=METHOD)
    start = np.arcsin(0.6)
    assert float(run.events.t[0]) == pytest.approx(start, abs=1e-12)
    t = np.asarray(run.t)
    slipped = np.where(t > start, np.cos(start) - np.cos(t) - 0.6 * (t - start), 0.0)
    np.testing.assert_allclose(run.x[:, 1], slipped, atol=1e-9)


@pytest.mark.slow
def test_stiction_holds_longer_than_kinetic_friction():
    run = lh.trajectory(STICKY, [0.0, 0.0], ARGS, t1=2.0, n=50, method=METHOD)
    start = np.arcsin(0.8)
    assert float(run.events.t[0]) == pytest.approx(start, abs=1e-12)
    t = np.asarray(run.t)
    slipped = np.where(t > start, np.cos(start) - np.cos(t) - 0.6 * (t - start), 0.0)
    np.testing.assert_allclose(run.x[:, 1], slipped, atol=1e-9)


@pytest.mark.slow
def test_the_convex_combination_stays_on_a_moving_curved_surface():
    """Sliding on the circle |x| = 1 + t/2: both fields point at it, and turn along it with different speeds."""

    def turning(rate, radial):
        return lambda t, x, args: rate * jnp.stack([-x[1], x[0]]) + radial * x / jnp.sqrt(jnp.sum(x**2))

    def circle(t, x, args):
        return jnp.sum(x**2) - (1 + t / 2) ** 2

    system = lh.filippov(turning(1.0, -1.0), turning(3.0, 1.0), circle)
    run = lh.trajectory(system, [1.0, 0.0], t1=1.0, n=10, method=METHOD)
    radius = np.sqrt(np.sum(np.asarray(run.x) ** 2, axis=1))
    np.testing.assert_allclose(radius, 1 + np.asarray(run.t) / 2, rtol=1e-8)
    # The radius grows by 1/2 where the share s of plus gives -s + (1 - s) = 1/2: s = 1/4, and it turns by 2.5.
    angle = np.unwrap(np.arctan2(run.x[:, 1], run.x[:, 0]))
    np.testing.assert_allclose(angle, 2.5 * np.asarray(run.t), rtol=1e-7)
    assert np.all(np.asarray(run.mode) == 2)


@pytest.mark.slow
def test_a_relay_with_a_dead_zone_slides_on_one_of_its_surfaces():
    """y' = −1, 0, +1 by regions; x' = 1 adds nothing: from above y falls to 1 and rests there."""

    def push(v):
        return lambda t, x, args: jnp.stack([1 + 0 * x[0], 0 * x[1] + v])

    down, pause, up = push(-1.0), push(0.25), push(1.0)
    system = lh.filippov([down, pause], [pause, up], [lambda t, x, a: x[1] - 1, lambda t, x, a: x[1] + 1])
    run = lh.trajectory(system, [0.0, 2.0], t1=3.0, n=6, method=METHOD)
    np.testing.assert_allclose(run.x[:, 1], [1.5, 1.0, 1.0, 1.0, 1.0, 1.0], atol=1e-12)
    assert system.mode_names[int(run.mode[-1])] == "sliding0"
    from_below = lh.trajectory(system, [0.0, -2.0], t1=11.0, n=11, method=METHOD)
    np.testing.assert_allclose(from_below.x[:, 1], np.minimum(-1 + 0.25 * np.arange(11), 1.0), atol=1e-12)


# Perturbations.


@pytest.mark.slow_cases("0")
@pytest.mark.parametrize("seed", range(3))
def test_saltation_matrices_come_out_of_the_general_formula(seed):
    """Three dimensions, a plane h·x = 0: crossing I + (f₋ − f₊)hᵀ/v₊; entering I + (fₛ − f₊)hᵀ/v₊; leaving I."""
    rng = np.random.default_rng(seed)
    a, b, h = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), rng.normal(size=3)
    x = rng.normal(size=3)
    x = x - h * (h @ x) / (h @ h)
    for kind, (up, down) in {"crossing": (-1.0, -0.4), "entering": (-1.0, 0.7)}.items():
        f_plus, f_minus = a @ x, b @ x
        plus = linear(a, h * (up - h @ f_plus) / (h @ h))
        minus = linear(b, h * (down - h @ f_minus) / (h @ h))
        system = lh.filippov(plus, minus, lambda t, x, args: jnp.asarray(h) @ x)
        f_plus, f_minus = (np.asarray(f(0.0, jnp.asarray(x), None)) for f in (plus, minus))
        after = f_minus if kind == "crossing" else (down * f_plus - up * f_minus) / (down - up)
        found = np.asarray(lh.saltation_matrix(system, 0.0, x, transition=0))
        np.testing.assert_allclose(found, np.eye(3) + np.outer(after - f_plus, h) / up, atol=1e-13)
        assert np.linalg.matrix_rank(found, tol=1e-12) == (3 if kind == "crossing" else 2)
        if kind == "entering":
            assert abs(system.fields[2](jnp.asarray(0.0), jnp.asarray(x), None) @ h) < 1e-13


def test_leaving_a_surface_changes_no_perturbation():
    start = np.arcsin(0.6)
    found = lh.saltation_matrix(BLOCK, start, [0.0, 0.0], ARGS, transition=2, which=0)
    np.testing.assert_allclose(found, np.eye(2), atol=1e-12)


def spring(direction):
    """A mass on a spring on a rough table: the force at which it breaks away depends on where it lies."""
    return lambda t, x, args: jnp.stack([x[1], 1.5 * jnp.sin(t) - x[0] - direction * args["kinetic"]])


def spring_margins(t, x, args):
    force = 1.5 * jnp.sin(t) - x[0]
    return jnp.stack([args["static"] - force, args["static"] + force])


@pytest.mark.slow
@pytest.mark.parametrize("stick", [None, spring_margins], ids=["kinetic", "static"])
def test_the_tangent_is_the_derivative_of_the_motion_through_sticks(stick):
    """δx₀ is what counts: δv₀ is destroyed by the first stick. Against central differences of the motion itself."""
    sliding = None if stick is None else rest
    system = lh.filippov(spring(1.0), spring(-1.0), velocity, sliding=sliding, stick=stick)
    method = lh.RungeKutta("dopri5", rtol=1e-11, atol=1e-13)
    run = lh.tangent_map(system, [0.2, 0.5], ARGS, t1=9.0, method=method)
    ends = [
        np.asarray(lh.tangent_map(system, [0.2 + dx, 0.5 + dv], ARGS, t1=9.0, method=method).x)
        for dx, dv in ((1e-5, 0.0), (-1e-5, 0.0), (0.0, 1e-5), (0.0, -1e-5))
    ]
    differences = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=1) / 2e-5
    np.testing.assert_allclose(run.matrix, differences, atol=2e-7)
    assert int(run.jumps) >= 3
    assert np.linalg.matrix_rank(np.asarray(run.matrix), tol=1e-12) == 1


@pytest.mark.slow
def test_a_direction_that_a_surface_has_no_room_for_is_lost_for_good():
    """The motion slides before growth is counted, and never leaves: −inf, not the 0 of a column that nobody moves."""
    problem = zoo.relay_feedback(form="sliding")
    spectrum = problem.spectrum(method=METHOD)
    assert float(spectrum.exponents[0]) == pytest.approx(-0.5, abs=1e-9)
    assert np.isneginf(spectrum.exponents[1])
    assert "rank_lost" in spectrum.notes
    assert spectrum.losses[1] == 0  # it happened in the transient
    whole = problem.spectrum(method=METHOD, transient=0.0)
    assert whole.losses[1] == 1
    assert 0.0 < float(whole.first_loss[1]) < 5.0


@pytest.mark.slow
def test_a_run_that_begins_on_the_surface_has_no_perturbation_across_it():
    problem = zoo.relay_feedback(form="sliding", slope=0.5)
    run = lh.tangent_map(problem.system, [0.8, -0.4], problem.args, t1=2.0, method=METHOD)
    # (x₁, x₂) = (1, −1/2) e^{−t/2} along the surface; across it nothing is left.
    along, across = np.array([1.0, -0.5]) / np.sqrt(1.25), np.array([0.5, 1.0]) / np.sqrt(1.25)
    np.testing.assert_allclose(run.matrix @ along, np.exp(-1.0) * along, atol=1e-9)
    np.testing.assert_allclose(run.matrix @ across, 0.0, atol=1e-12)


@pytest.mark.slow
def test_starts_in_different_modes_run_side_by_side():
    starts = jnp.array([[0.0, 0.3], [0.0, -0.3], [0.0, 0.0]])
    together = jax.vmap(lambda x: lh.tangent_map(BLOCK, x, ARGS, t1=3.0, method=METHOD).matrix)(starts)
    for x, matrix in zip(starts, together, strict=True):
        np.testing.assert_allclose(matrix, lh.tangent_map(BLOCK, x, ARGS, t1=3.0, method=METHOD).matrix, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plus", "minus", "mode"), [(1, -1, "plus"), (-1, 1, "minus"), (-1, -1, "sliding"), (1, 1, None)]
)
def test_a_start_at_a_two_fold_goes_where_a_field_curves_away(plus, minus, mode):
    """y' = ± x and x' = 1 from x = y = 0: both fields are tangent there, y = ± x²/2 leaves or comes back."""
    folded = lh.filippov(
        lambda t, x, args: jnp.stack([1.0 + 0 * x[0], plus * x[0]]),
        lambda t, x, args: jnp.stack([1.0 + 0 * x[0], -minus * x[0]]),
        lambda t, x, args: x[1],
    )
    if mode is None:
        ends = [np.asarray(one.spectrum.x) for one in lh.solutions(folded, [0.0, 0.0], t1=1.0).solutions]
        assert_allclose(sorted(end[1] for end in ends), [-0.5, 0.5], atol=1e-9)
        assert lh.trajectory(folded, [0.0, 0.0], t1=1.0, throw=False).status == STATUS.deadlock
        return
    run = lh.trajectory(folded, [0.0, 0.0], t1=1.0)
    assert run.mode_names[int(run.mode[-1])] == mode
    assert_allclose(run.x[-1], [1.0, {"plus": 0.5, "minus": -0.5, "sliding": 0.0}[mode]], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("verb", [lh.trajectory, lh.lyapunov_spectrum])
def test_a_start_outside_its_mode_is_refused(verb):
    """Both fields point at x = 0; off it nothing slides, and each side has one mode."""

    def towards(rate):
        return lambda t, x, args: jnp.stack([rate + 0 * t, -x[1]])

    block = lh.filippov(towards(-1.0), towards(1.0), lambda t, x, args: x[0])
    for mode, start in (("sliding", 0.7), ("minus", 0.7), ("plus", -1e-3), (2, 1e-3)):
        with pytest.raises(ValueError, match="x0 lies outside mode .* Leave mode out"):
            verb(block, [start, 1.0], t1=3.0, mode=mode)
    for mode, start in (("sliding", 0.0), ("sliding", 1e-12), ("minus", -0.7), ("plus", 0.0), ("minus", 0.0)):
        assert verb(block, [start, 1.0], t1=3.0, mode=mode).status == lh.STATUS.ok


@pytest.mark.slow
def test_reverse_derivatives_after_a_lost_direction():
    """A block that slips, sticks and slips: the direction that sticking destroys made all reverse derivatives nan."""

    def slips(sign):
        return lambda t, x, force: jnp.stack([x[1], force * jnp.cos(0.5 * t) - x[0] - 0.4 * sign])

    block = lh.filippov(slips(1), slips(-1), lambda t, x, force: x[1])

    def found(force):
        spectrum = lh.lyapunov_spectrum(block, jnp.array([0.0, 0.5]), force, t1=10.0, transient=0.0, blocks=2)
        return jnp.stack([spectrum.exponents[0], spectrum.x[0]])

    assert np.isneginf(lh.lyapunov_spectrum(block, [0.0, 0.5], 0.8, t1=10.0, transient=0.0).exponents[1])
    forward = jax.jacfwd(found)(0.8)
    assert np.all(np.abs(forward) > 0.1)
    assert_allclose(jax.jacrev(found)(0.8), forward, rtol=1e-9)
