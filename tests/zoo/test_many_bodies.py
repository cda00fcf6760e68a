"""Many bodies: the schedule against brute force, conserved quantities, pairing, zeros, reference values."""

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np
import pytest

import brute_force
import lyaphybrid as lh
from examples import alone, between_walls, wall_ahead
from lyaphybrid.engine.evolvers.scheduled import predicting_anew
from lyaphybrid.zoo.bodies.particles import hard_particles
from references import load_event_driven

DISKS = load_event_driven()["hard_disks"]
SIZES = np.random.default_rng(1)


def in_cells(problem):
    """The same problem, its bodies looked for in cells of the box, as it would be with more of them."""
    parameters, sides = problem.parameters, len(box_of(problem))
    system = hard_particles(parameters["n"], sides, parameters["walls"] == "hard", in_cells=True)
    return dataclasses.replace(problem, system=system)


def box_of(problem):
    return [float(problem.args[side]) for side in ("width", "height", "depth") if side in problem.args]


KINDS = {
    "disks": lambda: lh.zoo.hard_disks(n=16),
    "thin disks": lambda: lh.zoo.hard_disks(n=6, density=0.05, aspect=3.0),
    "two disks": lambda: lh.zoo.hard_disks(n=2, density=0.32, aspect=1.0),
    "mixture": lambda: lh.zoo.hard_disks(
        n=9, density=0.5, aspect=1.0, diameter=SIZES.uniform(0.5, 1.0, 9), mass=SIZES.uniform(0.2, 5.0, 9)
    ),
    "disks in a box": lambda: lh.zoo.hard_disks(n=9, density=0.5, walls="hard"),
    "spheres": lh.zoo.hard_spheres,
    "long box": lambda: lh.zoo.hard_spheres(n=11, density=0.3, aspect=(0.5, 2.0), mass=3.0, kinetic_energy=7.0),
    "spheres in a box": lambda: lh.zoo.hard_spheres(n=8, density=0.4, walls="hard"),
    "disks in cells": lambda: in_cells(lh.zoo.hard_disks(n=16)),
    "thin disks in cells": lambda: in_cells(lh.zoo.hard_disks(n=16, density=0.05, aspect=1.2)),
    "mixture in cells": lambda: in_cells(
        lh.zoo.hard_disks(n=16, density=0.5, diameter=SIZES.uniform(0.3, 1.0, 16), mass=SIZES.uniform(0.2, 5.0, 16))
    ),
    "disks in cells in a box": lambda: in_cells(lh.zoo.hard_disks(n=12, density=0.5, walls="hard")),
    "spheres in cells": lambda: in_cells(lh.zoo.hard_spheres(n=40, density=0.25)),
}
QUICK = ("mixture", "disks in a box", "spheres", "disks in cells in a box")


def of_problems(names):
    return pytest.mark.parametrize(
        "problem", [pytest.param(KINDS[n](), id=n, marks=() if n in QUICK else pytest.mark.slow) for n in names]
    )


kinds = of_problems(KINDS)


def body_count(problem):
    return problem.parameters["n"]


def masses(problem):
    return np.broadcast_to(np.asarray(problem.args["mass"]), body_count(problem))


def brute(problem, count):
    args, walls = problem.args, problem.parameters["walls"] == "hard"
    return brute_force.events(
        problem.x0, body_count(problem), box_of(problem), args["diameter"], args["mass"], walls, count
    )


def bodies(problem, name):
    """Which bodies take part in an event of this name: two, or one that meets a wall."""
    n, d = body_count(problem), len(box_of(problem))
    return {name // n, name % n} if name < n * n else {(name - n * n) // (2 * d)}


@pytest.mark.slow
@kinds
def test_the_first_two_hundred_events_by_brute_force(problem):
    """Chaos multiplies rounding until two exact programs differ: compared as far as they agree on what is next."""
    times, names, _ = brute(problem, 200)
    found = lh.trajectory(problem.system, problem.x0, problem.args, t1=float(times[-1]) * 1.01, n=1).events
    both = min(200, len(found))
    which, t = np.asarray(found.which)[:both], np.asarray(found.t)
    same = int(np.argmin(np.append(which == names[:both], False)))
    rounding = np.abs(t[:same] - times[:same]) / times[:same]
    assert same >= 10
    assert np.all(rounding[:10] < 1e-9)
    if same < both:  # where they part, the times of those that meet had grown apart before
        meet = bodies(problem, which[same]) | bodies(problem, names[same])
        assert max(rounding[i] for i in range(same) if bodies(problem, names[i]) & meet) > 1e-6, same


@pytest.mark.slow_cases("spheres", "disks in cells in a box", "mixture")
@kinds
def test_the_schedule_and_predicting_anew_agree(problem):
    """The same system, every pair at each event: the naive form."""
    naive = predicting_anew(problem.system, problem.x0.shape)
    t1 = float(np.mean(brute(problem, 16)[0][-2:]))
    fast, slow = (lh.trajectory(s, problem.x0, problem.args, t1=t1, n=1).events for s in (problem.system, naive))
    assert len(fast) == len(slow) == 15
    np.testing.assert_array_equal(fast.which, slow.which)
    np.testing.assert_allclose(fast.t, slow.t, rtol=0, atol=1e-6 * t1)


@pytest.mark.slow_cases("spheres", "disks in cells in a box", "mixture")
@kinds
def test_energy_momentum_and_distances(problem):
    n, d = body_count(problem), len(box_of(problem))
    end = lh.trajectory(problem.system, problem.x0, problem.args, t1=60.0, n=4).x[-1]
    q, p = np.asarray(end).reshape(2, n, d)
    energy = float(np.sum(p**2 / masses(problem)[:, None])) / 2
    np.testing.assert_allclose(energy, problem.parameters["kinetic_energy"], rtol=1e-11)
    sizes = np.broadcast_to(np.asarray(problem.args["diameter"]), n)
    if problem.parameters["walls"] == "hard":
        inside = np.minimum(q, np.array(box_of(problem)) - q) - sizes[:, None] / 2
        assert np.min(inside) > -1e-9
    else:
        assert np.max(np.abs(np.sum(p, axis=0))) < 1e-10
    for a, b in itertools.combinations(range(n), 2):
        apart = q[b] - q[a]
        if problem.parameters["walls"] != "hard":
            apart = apart - np.array(box_of(problem)) * np.round(apart / np.array(box_of(problem)))
        assert np.linalg.norm(apart) > (sizes[a] + sizes[b]) / 2 - 1e-9


@pytest.mark.slow
@kinds
def test_the_tangent_map_is_the_derivative(problem):
    """Central differences along two directions, over a stretch with several events."""
    t1 = float(brute(problem, 6)[0][5]) + 1e-3
    matrix = lh.tangent_map(problem.system, problem.x0, problem.args, t1=t1).matrix
    for seed in range(2):
        dx = np.random.default_rng(seed).normal(size=problem.x0.shape)
        h = 1e-7
        ends = [lh.trajectory(problem.system, problem.x0 + sign * h * dx, problem.args, t1=t1, n=1) for sign in (1, -1)]
        assert len(ends[0].events) == len(ends[1].events) >= 6
        difference = (ends[0].x[-1] - ends[1].x[-1]) / (2 * h)
        np.testing.assert_allclose(matrix @ dx, difference, rtol=0, atol=1e-4 * float(jnp.max(jnp.abs(difference))))


@pytest.mark.slow
@of_problems([name for name in KINDS if "cells" not in name])
def test_zeros_and_pairs(problem):
    """Energy and momenta with their partners are zeros; every λ has its -λ."""
    d, free = len(box_of(problem)), problem.parameters["walls"] != "hard"
    spectrum = problem.spectrum(t1=60.0, transient=0.0)
    exponents = np.asarray(spectrum.exponents)
    assert np.max(np.abs(exponents + exponents[::-1])) < 1e-9
    # A frame in general position: only ln(t)/t is left of the zeros.
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(len(exponents),) * 2))[0]
    generic = np.sort(np.abs(problem.spectrum(t1=600.0, transient=20.0, frame=frame).exponents))
    zeros = 2 * d + 2 if free else 2
    assert generic[zeros - 1] < min(0.05, 0.4 * generic[zeros])


@pytest.mark.slow
def test_a_box_too_small_for_cells_is_refused():
    """With three cells an axis the nearest image would not always be the one that is met."""
    problem = in_cells(lh.zoo.hard_disks(n=9, density=0.7))
    spectrum = problem.spectrum(t1=1.0, throw=False)
    assert (spectrum.status, int(spectrum.jumps)) == (lh.STATUS.nonfinite, 0)


@pytest.mark.slow
@pytest.mark.parametrize("make", [lh.zoo.hard_disks, lh.zoo.hard_spheres])
def test_many_are_looked_for_in_cells_and_meet_as_all_do(make):
    problem = make(n=400)
    parameters = problem.parameters
    all_partners = hard_particles(400, len(box_of(problem)), parameters["walls"] == "hard")
    assert problem.system is not all_partners
    cells, rows = (lh.trajectory(s, problem.x0, problem.args, t1=1.0, n=1) for s in (problem.system, all_partners))
    there = np.asarray(rows.events.which) >= 0  # the others only look again
    assert len(cells.events) > 1000
    np.testing.assert_array_equal(cells.events.which, rows.events.which[there])
    np.testing.assert_allclose(cells.events.t, rows.events.t[there], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_state_in_rows_goes_in_and_comes_out():
    """Rows (position, momentum) of balls between two walls that do not see each other: a schedule written by a user."""
    balls = lh.EventDriven(
        lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
        None,
        lambda t, rows, args, which: jnp.stack([rows[:, 0] + 2 * t * rows[:, 1], -rows[:, 1]], axis=1),
        between_walls,
        schedule=alone(wall_ahead),
    )
    x0 = np.array([[0.5, 1.0], [0.25, -0.7], [0.1, 0.3]])
    path = lh.trajectory(balls, x0, t1=10.0, n=5)
    assert path.x.shape == (5, 3, 2)
    folded = np.mod(x0[:, 0] + 10.0 * x0[:, 1], 2)
    np.testing.assert_allclose(path.x[-1, :, 0], np.where(folded > 1, 2 - folded, folded), atol=1e-12)
    several = lh.lyapunov_spectrum(balls, np.stack([x0, x0 / 2]), t1=50.0)
    one = lh.lyapunov_spectrum(balls, x0, t1=50.0)
    assert (one.x.shape, several.x.shape, one.frame.shape) == ((3, 2), (2, 3, 2), (6, 6))
    np.testing.assert_allclose(several.x[0], one.x, atol=1e-12)
    np.testing.assert_allclose(several.replicates[0], one.exponents, atol=1e-12)
    assert np.max(np.abs(one.exponents)) < 0.2  # ln t/t
    assert one.sum_rule_residual < 1e-12
    matrix = lh.saltation_matrix(balls, 0.0, [[0.5, 1.0], [0.0, -0.7], [0.1, 0.3]], which=1)
    np.testing.assert_allclose(matrix, np.diag([1, 1, -1, -1, 1, 1]), atol=1e-15)
    with pytest.raises(ValueError, match=r"\(N, d\), one row a body"):
        lh.trajectory(balls, x0.ravel(), t1=1.0)


@pytest.mark.slow
def test_four_times_the_energy_is_twice_the_speed():
    """K → 4K multiplies every number of a run by a power of two: not one bit may differ."""
    slow, fast = (lh.zoo.hard_spheres(kinetic_energy=energy) for energy in (8.0, 32.0))
    units = np.repeat([1.0, 2.0], 24)
    np.testing.assert_array_equal(fast.x0, units * np.asarray(slow.x0))
    one, other = (lh.trajectory(p.system, p.x0, p.args, t1=t1, n=1) for p, t1 in ((slow, 8.0), (fast, 4.0)))
    assert len(one.events) == len(other.events) > 100
    np.testing.assert_array_equal(2 * other.events.t, one.events.t)
    np.testing.assert_array_equal(other.x, units * np.asarray(one.x))
    one, other = (lh.tangent_map(p.system, p.x0, p.args, t1=t1).matrix for p, t1 in ((slow, 1.0), (fast, 0.5)))
    np.testing.assert_array_equal(other, units[:, None] * np.asarray(one) / units[None, :])


@pytest.mark.slow
def test_exponents_go_as_the_root_of_the_energy_over_the_mass():
    """K → 4K with m → m/4 leaves the momenta, and so the metric of the frame, as they are: λ → 4λ exactly."""
    slow, fast = (lh.zoo.hard_spheres(kinetic_energy=8.0 * c, mass=1.0 / c) for c in (1.0, 4.0))
    one, other = slow.spectrum(t1=32.0, transient=4.0), fast.spectrum(t1=8.0, transient=1.0)
    assert one.jumps == other.jumps > 500
    np.testing.assert_allclose(np.asarray(other.exponents), 4 * np.asarray(one.exponents), rtol=1e-12, atol=1e-12)
