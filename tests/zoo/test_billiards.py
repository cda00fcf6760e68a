"""Billiards: contacts against brute force, exponents and free paths against what is known, laws, fields."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo

STRAIGHT = [
    ("sinai_billiard", {"radius": 0.2}),
    ("lorentz_gas", {}),
    ("stadium", {"side": 1.5, "radius": 0.7}),
    ("ellipse", {}),
    ("wedge", {"angle": 1.1}),
]
MAGNETIC = [
    ("sinai_billiard", {"field": 0.7}),
    ("sinai_billiard", {"field": -9.0}),  # gyration circles smaller than the disks: hops along them
    ("lorentz_gas", {"gap": 0.8, "field": 0.6}),
    ("stadium", {"field": -0.4}),
    ("stadium", {"side": 2.0, "field": 3.0}),  # arcs that cross a line and come back, or meet no wall
]
ALL = STRAIGHT + MAGNETIC


def each(cases):
    return pytest.mark.parametrize(("name", "parameters"), cases, ids=[f"{n}{p or ''}" for n, p in cases])


# The walls, written anew: how far inside all of them a point is; one row a point.


def disks(q, centres, radius):
    """Distance to the nearest of the disks."""
    return np.min(np.linalg.norm(q[:, None] - centres[None], axis=-1), axis=1) - radius


def lattice(a, b, reach):
    i, j = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    return i.reshape(-1, 1) * np.array(a) + j.reshape(-1, 1) * np.array(b)


def clearance(problem, q):
    name, p = problem.name, problem.parameters
    x, y = q.T
    if name == "sinai_billiard":
        return disks(q - np.round(q), lattice((1, 0), (0, 1), 1), p["radius"])
    if name == "lorentz_gas":
        spacing, up = 2 + p["gap"], math.sqrt(3) / 2
        row = np.round(y / (spacing * up))
        home = np.stack([x - spacing * np.round(x / spacing - row / 2) - spacing * row / 2, y - spacing * up * row], 1)
        return disks(home, spacing * lattice((1, 0), (0.5, up), 1), 1.0)
    if name == "stadium":
        return p["radius"] - np.hypot(np.maximum(np.abs(x) - p["side"] / 2, 0), y)
    if name == "ellipse":
        return 1 - np.hypot(x / p["a"], y / p["b"])
    return y * math.sin(p["angle"]) - np.abs(x) * math.cos(p["angle"])


def path(problem, x, t):
    """Positions (times, 2), by complex numbers and by Galilei."""
    q, v, t = complex(*x[:2]), complex(*x[2:]), np.asarray(t)
    field = problem.parameters.get("field", 0.0)
    if field:
        z = q + v * (np.exp(1j * field * t) - 1) / (1j * field)
    else:
        z = q + v * t - (0.5j * t**2 if problem.name == "wedge" else 0)
    return np.stack([z.real, z.imag], axis=1)


def first_contact(problem, x, longest, n=3000):
    """Dense sampling, then bisection; inf where nothing comes within the longest time."""
    t = np.linspace(0, longest, n + 1)[1:]
    behind = np.flatnonzero(clearance(problem, path(problem, x, t)) < 0)
    if behind.size == 0:
        return np.inf
    low, high = t[behind[0]] - t[0], t[behind[0]]
    for _ in range(60):
        middle = (low + high) / 2
        outside = clearance(problem, path(problem, x, [middle]))[0] < 0
        low, high = (low, middle) if outside else (middle, high)
    return low


def random_states(problem, count, seed):
    """Points between the walls, at least 1e-3 off, and directions."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-3, 3, (40 * count, 2))
    q = q[clearance(problem, q) > 1e-3][:count]
    angle = rng.uniform(0, 2 * math.pi, count)
    return np.stack([*q.T, np.cos(angle), np.sin(angle)], axis=1)


@functools.cache
def flights(system):
    """(states, args) -> up to the first wall or 40 looks: time, which, states after the flight and after the jump."""

    def flight(x, args):
        def look(carry):
            x, flown, _, looks = carry
            dt, which = system.next_event(0.0, x, args)
            return system.flow(jnp.where(dt < jnp.inf, dt, 0.0), 0.0, x, args), flown + dt, which, looks + 1

        def on(carry):
            _, flown, which, looks = carry
            return (which < 0) & (looks < 40) & (flown < jnp.inf)

        x, flown, which, _ = jax.lax.while_loop(on, look, (x, 0.0, jnp.asarray(-1), 0))
        return flown, which, x, system.jump(0.0, x, args, which)

    return jax.jit(jax.vmap(flight, (0, None)))


def contacts(problem, states):
    """Sixty at a time, so that a system is compiled once."""
    parts = [flights(problem.system)(jnp.asarray(part), problem.args) for part in states.reshape(-1, 60, 4)]
    return [np.concatenate(values) for values in zip(*parts, strict=True)]


FAR = 40.0  # not followed further by brute force


def assert_first(problem, x, dt):
    """The brute force finds this contact and no earlier one."""
    expected = first_contact(problem, x, min(dt, FAR) * 1.001)
    if dt < FAR:
        assert_allclose(dt, expected, atol=1e-9)
    else:
        assert expected == np.inf


@pytest.mark.slow_cases(
    all_but=(
        "ellipse",
        "wedge{'angle': 1.1}",
    )
)
@each(ALL)
def test_the_first_contact_is_that_of_brute_force(name, parameters):
    """From anywhere; and from the wall itself, which is left before sampling begins."""
    problem = zoo.get(name)(**parameters)
    states = random_states(problem, 60, seed=1)
    times, which, _, after = contacts(problem, states)
    assert np.all(which[times < FAR] >= 0)
    for x, dt in zip(states, times, strict=True):
        assert_first(problem, x, dt)
    for _ in range(3):
        states = np.where((times < FAR)[:, None], after, states)
        times, _, landed, after = contacts(problem, states)
    met = times < FAR
    assert np.sum(met) > 20
    assert np.all(times > 0)
    assert np.max(np.abs(clearance(problem, landed[met, :2]))) < 1e-12
    for x, dt in zip(states, times, strict=True):
        t = min(dt, FAR) * np.linspace(1e-3, 1 - 1e-3, 2000)
        assert np.all(clearance(problem, path(problem, x, t)) > -1e-13)


@pytest.mark.slow_cases("sinai_billiard{'field': 9.0}", "stadium{'field': 0.4}")
@each([("stadium", {}), ("ellipse", {}), ("sinai_billiard", {"field": 9.0}), ("stadium", {"field": 0.4})])
def test_whispers_along_a_wall(name, parameters):
    """Many hops, of twice the angle at which the wall is left over the difference of the curvatures."""
    problem, angle = zoo.get(name)(**parameters), np.geomspace(1e-6, 1e-2, 60)
    x, curvature = {"stadium": (1.5, 1.0), "ellipse": (2.0, 2.0), "sinai_billiard": (0.4, 2.5)}[name]
    inward = 1 if name == "sinai_billiard" else -1
    states = np.stack([np.full(60, x), np.zeros(60), inward * np.sin(angle), np.cos(angle)], axis=1)
    expected, arc = 2 * angle / abs(curvature - parameters.get("field", 0.0)), np.zeros(60)
    for _ in range(50):
        times, which, _, states = contacts(problem, states)
        here = arc < (0.02 if name == "ellipse" else 1.0)  # the curvature is still that of the start
        assert_allclose(times[here], expected[here], rtol=1e-2)
        assert np.max(np.abs(clearance(problem, states[:, :2]))) < 1e-13
        assert np.all(which >= 0)
        arc += times


@pytest.mark.slow
def test_no_disk_is_missed_along_open_corridors():
    """Gap 1: rays that fly far, against all disks of a large patch at once."""
    problem = zoo.lorentz_gas(gap=1.0)
    states = random_states(problem, 420, seed=3)
    states[::2, 2:] = np.stack([np.ones(210), np.linspace(-0.2, 0.2, 210)], axis=1)  # along a corridor, slightly off
    states[:, 2:] /= np.linalg.norm(states[:, 2:], axis=1, keepdims=True)
    times, which, _, _ = contacts(problem, states)
    centres = 3.0 * lattice((1, 0), (0.5, math.sqrt(3) / 2), 60)
    d = centres[None] - states[:, None, :2]
    along = np.einsum("snk,sk->sn", d, states[:, 2:])
    off = np.sum(d * d, axis=2) - along**2
    expected = np.min(np.where((off < 1) & (along > 0), along - np.sqrt(np.maximum(1 - off, 0)), np.inf), axis=1)
    near = expected < 50
    assert np.sum((expected > 10) & near) > 10
    assert np.all(which[near] == 0)
    assert_allclose(times[near], expected[near], rtol=1e-10, atol=1e-10)


def test_corridors_open_at_the_bound():
    """4/√3 − 2 = 0.3094: below it no straight path is long, above it a ray between two rows is free."""
    assert np.max(contacts(zoo.lorentz_gas(gap=0.3), random_states(zoo.lorentz_gas(gap=0.3), 4200, seed=4))[0]) < 6
    for gap, free in ((0.309, False), (0.31, True)):
        between = np.tile([0.0, (2 + gap) * math.sqrt(3) / 4, 1.0, 0.0], (60, 1))
        assert np.all((contacts(zoo.lorentz_gas(gap=gap), between)[0] > FAR) == free)


# Laws.


def start(problem):
    """Where the problem starts; in a strong field near a wall, for in the middle no wall is met."""
    near = {-9.0: [0.45, 0.0, -1.0, 0.0], 3.0: [0.1, 0.9, 0.6, 0.8]}
    return jnp.asarray(near.get(problem.parameters.get("field"), problem.x0))


@functools.cache
def end(system):
    """(x, args, t1) -> the state at t1, by nothing but the system's own functions."""

    def run(x, args, t1):
        def go(carry):
            x, left = carry
            dt, which = system.next_event(0.0, x, args)
            return system.jump(0.0, system.flow(dt, 0.0, x, args), args, which), left - dt

        x, left = jax.lax.while_loop(lambda c: system.next_event(0.0, c[0], args)[0] < c[1], go, (x, t1))
        return system.flow(left, 0.0, x, args)

    return jax.jit(jax.vmap(run, (0, None, None)))


QUICK = [("stadium", {"field": -0.4})]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters"),
    [pytest.param(*case, marks=() if case in QUICK else pytest.mark.slow) for case in ALL],
    ids=[f"{n}{p or ''}" for n, p in ALL],
)
def test_the_tangent_map_is_that_of_the_trajectory(name, parameters):
    """Central differences over several reflections; and energy is conserved."""
    problem = zoo.get(name)(**parameters)
    x0, h = start(problem), 1e-7
    t1 = {"sinai_billiard": 2.0, "lorentz_gas": 3.5}.get(name, 8.0) * (1.0 if "gap" not in parameters else 2.5)
    t1 = 5.0 if "radius" in parameters and name == "sinai_billiard" else t1
    found = lh.tangent_map(problem.system, x0, problem.args, t1=t1)
    assert found.jumps >= 3
    around = x0[None, :] + h * np.concatenate([np.zeros((1, 4)), np.eye(4), -np.eye(4)])
    ends = np.asarray(end(problem.system)(around, problem.args, t1))
    scale = np.max(np.abs(found.matrix))
    assert_allclose(found.x, ends[0], atol=1e-12 * scale)
    assert_allclose(found.matrix, (ends[1:5] - ends[5:]).T / (2 * h), atol=1e-5 * scale)
    late = np.asarray(end(problem.system)(around, problem.args, 500.0))
    assert_allclose(energy(problem, late), energy(problem, around), rtol=1e-12)


def energy(problem, x):
    return np.sum(x[:, 2:] ** 2, axis=1) / 2 + (x[:, 1] if problem.name == "wedge" else 0)


def test_the_ellipse_conserves_the_product_of_two_angular_momenta():
    problem = zoo.ellipse(a=1.7, b=1.1)
    focus = math.sqrt(1.7**2 - 1.1**2)

    def product(states):
        x, y, vx, vy = np.asarray(states).T
        return ((x - focus) * vy - y * vx) * ((x + focus) * vy - y * vx)

    states = random_states(problem, 9, seed=5)
    assert np.ptp(product(states)) > 1
    assert_allclose(product(end(problem.system)(states, problem.args, 1000.0)), product(states), atol=1e-10)


def test_the_wedge_conserves_energy():
    problem = zoo.wedge(angle=1.1)
    states = random_states(problem, 9, seed=6)
    late = np.asarray(end(problem.system)(states, problem.args, 1000.0))
    assert_allclose(energy(problem, late), energy(problem, states), rtol=1e-12)


# Fields.


def with_traced_field(name, field):
    """The system is that of a field, also where it is 0."""
    return dataclasses.replace(zoo.get(name)(field=1.0), args=zoo.get(name)().args | {"field": field})


@pytest.mark.parametrize("name", ["sinai_billiard", "lorentz_gas", "stadium"])
def test_without_a_field_arcs_are_straight(name):
    straight = zoo.get(name)()
    states = random_states(straight, 60, seed=8)
    for known, found in zip(contacts(straight, states), contacts(with_traced_field(name, 0.0), states), strict=True):
        assert_allclose(found, known, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sinai_billiard", "lorentz_gas", "stadium"])
def test_the_derivative_by_a_weak_field(name):
    """A traced field may be 0; the derivative, also of the contacts' times, is that of small fields."""
    build = zoo.get(name)
    start = build().x0

    def bounce(_, x, system, args):
        dt, which = system.next_event(0.0, x, args)
        return system.jump(0.0, system.flow(dt, 0.0, x, args), args, which)

    def run(field):
        problem = build(field=field)
        step = functools.partial(bounce, system=problem.system, args=problem.args)
        return jax.lax.fori_loop(0, 4, step, start)

    def with_slope(field):
        return jax.jvp(run, (field,), (1.0,))

    fields = jnp.array([0.0, 1e-6, -1e-6, 1e-14, 1e-10, 1e-5])
    ends, slopes = map(np.asarray, jax.jit(jax.vmap(with_slope))(fields))
    scale = np.max(np.abs(slopes[0]))
    assert scale > 0.1
    assert_allclose(slopes[0], (ends[1] - ends[2]) / 2e-6, atol=1e-5 * scale)
    assert_allclose(slopes[3:], np.tile(slopes[0], (3, 1)), atol=1e-3 * scale)


def test_another_field_does_not_compile_again():
    a, b = zoo.stadium(field=0.3), zoo.stadium(field=-2.0)
    assert a.system is b.system is not zoo.stadium().system
    assert not a.system.canonical
    assert zoo.stadium().system.canonical


@pytest.mark.slow
def test_a_point_that_meets_no_wall_turns_for_ever():
    for name in ("sinai_billiard", "stadium"):
        problem = zoo.get(name)(field=20.0)
        assert np.all(contacts(problem, np.tile(problem.x0, (60, 1)))[0] == np.inf)
    late = end(problem.system)(jnp.tile(problem.x0, (9, 1)), problem.args, 20 * math.pi)
    assert_allclose(late[0], problem.x0, atol=1e-12)  # after 200 turns


# Exponents and free paths.


def assert_within(value, error, known, known_error, deviations, gate, what):
    off = (value - known) / math.hypot(error, known_error)
    print(f"{what}: {value:.6g} ± {error:.2g}, known {known:.6g} ± {known_error:.2g}: off by {off:.2f} standard errors")
    assert error <= gate * known
    assert abs(off) <= deviations


slow = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters", "key", "jumps"),
    [
        ("lorentz_gas", {"gap": 0.3}, ("tri", 0.3), 4000),
        pytest.param("sinai_billiard", {"radius": 0.4}, ("sq", 0.4), 20_000, marks=slow),
        pytest.param("sinai_billiard", {"radius": 0.2}, ("sq", 0.2), 20_000, marks=slow),
        pytest.param("stadium", {"side": 1.0}, ("stad", 1), 20_000, marks=slow),
        pytest.param("lorentz_gas", {"gap": 0.8}, None, 20_000, marks=slow),  # open corridors
        pytest.param("sinai_billiard", {"radius": 0.4, "field": 0.5}, None, 20_000, marks=slow),
    ],
)
def test_exponents_and_free_paths(event_driven, name, parameters, key, jumps):
    """Sixteen independent starts, each with the same number of reflections."""
    problem, m = zoo.get(name)(**parameters), 16
    run = problem.spectrum(x0=random_states(problem, m, seed=7), t1=jumps, transient=0, clock="jumps")
    paths, per_jump = np.asarray(run.t) / jumps, np.asarray(run.replicates[:, 0])

    def error(values):
        return np.std(values, ddof=1) / math.sqrt(m)

    free_path, values = zoo.mean_free_path(problem), np.asarray(run.exponents)
    assert_within(np.mean(paths), error(paths), free_path, 0.0, 3, 0.01, "mean free path")
    assert_allclose(values[1:-1], 0, atol=10 * math.log(jumps) / jumps)
    assert_allclose(values + values[::-1], 0, atol=1e-9 if problem.system.canonical else 1e-3)
    if key is None:
        return
    known = event_driven["billiards"][key]
    assert_allclose(free_path, known["mfp_exact"], rtol=1e-11)
    reference = problem.reference
    assert (reference.exponents[0], reference.stderr[0]) == (known["lam_time_best"], known["se_best"])
    per_time = per_jump / paths
    assert_within(values[0], error(per_jump), known["lam_coll"], known["se_coll"], 5, 0.01, "per reflection")
    assert_within(np.mean(per_time), error(per_time), known["lam_time_best"], known["se_best"], 5, 0.01, "per time")


@pytest.mark.slow
@pytest.mark.parametrize("build", [zoo.ellipse, zoo.wedge])
def test_integrable_billiards_have_zero_exponents(build):
    """They decay like ln t/t."""
    problem = build()
    early, late = (np.asarray(problem.spectrum(t1=t1, transient=0.0).exponents) for t1 in (1000.0, 30_000.0))
    assert_allclose(late, problem.reference.exponents, atol=1e-3)
    assert np.max(late) < np.max(early) / 5


@pytest.mark.slow
def test_a_wide_wedge_is_chaotic():
    """And four times the energy halves the exponent."""
    problem = zoo.wedge(angle=1.1)
    near = jnp.tile(problem.x0, (8, 1)) * (1 + 1e-6 * jnp.arange(8.0)[:, None])
    one = problem.spectrum(x0=near, t1=5000.0)
    other = problem.spectrum(x0=near * jnp.array([[4.0, 4.0, 2.0, 2.0]]), t1=5000.0)
    assert one.exponents[0] > 0.3
    assert_allclose(one.exponents + one.exponents[::-1], 0, atol=1e-9)
    error = math.hypot(one.stderr[0], 2 * other.stderr[0])
    assert error < 0.01
    assert abs(one.exponents[0] - 2 * other.exponents[0]) < 5 * error


def test_mean_free_paths_are_known_for_some():
    expected = math.pi * (2 + math.pi / 4) / (4 + math.pi)
    assert_allclose(zoo.mean_free_path(zoo.stadium(side=2.0, radius=0.5)), expected)
    slope = jax.grad(lambda r: zoo.mean_free_path(zoo.sinai_billiard(radius=r)))(0.4)
    assert_allclose(slope, -1 / 0.32 - math.pi / 2)
    with pytest.raises(
        ValueError, match="the problem must be one of 'sinai_billiard', 'lorentz_gas', 'stadium'; got 'w"
    ):
        zoo.mean_free_path(zoo.wedge())
