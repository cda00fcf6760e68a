"""Collision statistics: against closed forms, the virial theorem term by term, equations of state, kinetic theory."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.zoo.bodies import statistics
from lyaphybrid.zoo.bodies.statistics import kick_by_energy
from references import load_event_driven

SIZES = np.random.default_rng(5).uniform(0.5, 1.0, 9)
MASSES = np.random.default_rng(6).uniform(0.2, 5.0, 9)
KINDS = {
    "disks": lambda: lh.zoo.hard_disks(n=16),
    "mixture": lambda: lh.zoo.hard_disks(n=9, density=0.5, aspect=1.0, diameter=SIZES, mass=MASSES),
    "mixture in a box": lambda: lh.zoo.hard_disks(n=6, density=0.4, diameter=SIZES[:6], mass=MASSES[:6], walls="hard"),
    "spheres": lambda: lh.zoo.hard_spheres(kinetic_energy=5.0, mass=2.0),
    "spheres in a box": lambda: lh.zoo.hard_spheres(n=5, density=0.3, aspect=(0.7, 1.2), walls="hard"),
}


QUICK = ("mixture in a box",)  # every other one compiles for seconds
kinds = pytest.mark.parametrize("kind", [k if k in QUICK else pytest.param(k, marks=pytest.mark.slow) for k in KINDS])
walled = pytest.mark.parametrize("kind", ["mixture in a box", pytest.param("spheres in a box", marks=pytest.mark.slow)])


def agree(found, expected, gate, error=0.0):
    """Within five standard errors, and the error below a gate, relative to the value."""
    stderr = math.hypot(found.stderr, error)
    assert 0 < stderr < gate * abs(expected)
    assert abs(found.value - expected) <= 5 * stderr, (found, expected)


def freedom(problem):
    n, d = problem.parameters["n"], 3 if "depth" in problem.args else 2
    return d * n if problem.parameters["walls"] == "hard" else d * (n - 1)


# Closed forms.


@pytest.fixture(scope="module")
def two_disks():
    """Sinai's billiard; its free path is π area/perimeter, that of one disk half of it."""
    problem = lh.zoo.hard_disks(n=2, density=0.32, aspect=1)
    return lh.zoo.collision_statistics(problem, t1=30_000.0)


@pytest.mark.slow
def test_two_disks_are_a_billiard_with_a_known_free_path(two_disks):
    side, speed = 2.5, 2 * math.sqrt(2)
    path = math.pi * (side**2 - math.pi) / (2 * math.pi)
    agree(two_disks.mean_free_path, path / 2, 0.006)
    agree(two_disks.mean_free_time, path / speed, 0.006)
    agree(two_disks.rate, speed / path, 0.006)
    # The mean of |cos| over the flux on the circle is π/4; J = |w| |cos|, √μ = √½.
    agree(two_disks.kick, speed * math.sqrt(2) * math.pi / 4, 0.006)
    reference = load_event_driven()["hard_disks"]["N2_square_L2.5"]
    agree(two_disks.rate, reference["collision_rate"], 0.01, reference["collision_rate_se"])


def test_disks_on_a_line():
    """Two that meet head on: each flight is L - 2σ in relative distance, each kick 2μw; nothing else happens."""
    problem = lh.zoo.hard_disks(n=2, density=0.125, aspect=1.0, diameter=0.75, mass=3.0)
    momentum, side, reach, reduced = 1.5, 4.0, 0.75, 1.5
    x0 = jnp.array([1.0, 1.0, 3.0, 1.0, momentum, 0.0, -momentum, 0.0])
    problem, speed = dataclasses.replace(problem, x0=x0), momentum / reduced
    period = (side - 2 * reach) / speed
    found = lh.zoo.collision_statistics(problem, t1=40 * period, transient=0.0, blocks=4)
    energy, kick = momentum**2 / 2 / reduced, 2 * momentum
    assert found.collisions == 40
    expected = {
        "rate": 1 / period,
        "mean_free_time": period,
        "mean_free_path": speed * period / 2,
        "kick": kick / math.sqrt(reduced),
        "pressure": (2 * energy + reach * kick / period) / 2 / side**2,
        "compressibility": 1 + reach * kick / period / (2 * energy),
    }
    for name, value in expected.items():
        measured = getattr(found, name)
        np.testing.assert_allclose(measured.value, value, rtol=1e-12, err_msg=name)
        assert measured.stderr < 1e-10
    assert found.wall_rate is found.wall_pressure is None


@walled
def test_the_virial_theorem_between_walls_to_rounding(kind):
    """d/dt Σ (q - centre)·p is what the two pressures differ by: at any time, not only on average."""
    problem = KINDS[kind]()
    n, t1 = problem.parameters["n"], 3.0
    found = lh.zoo.collision_statistics(problem, t1=t1, transient=0.0, blocks=2)
    sides = np.array([float(problem.args[s]) for s in ("width", "height", "depth") if s in problem.args])
    end = lh.trajectory(problem.system, problem.x0, problem.args, t1=t1, n=1).x[-1]
    (q0, p0), (q1, p1) = (np.asarray(x).reshape(2, n, -1) for x in (problem.x0, end))
    change = np.sum((q1 - sides / 2) * p1) - np.sum((q0 - sides / 2) * p0)
    assert found.collisions > 3
    expected = change / (t1 * len(sides) * np.prod(sides))
    np.testing.assert_allclose(found.pressure.value - found.wall_pressure.value, expected, rtol=0, atol=1e-9)


@walled
def test_both_pressures_between_walls(kind):
    found = lh.zoo.collision_statistics(KINDS[kind](), t1=400.0)
    assert found.wall_rate.value > 1
    agree(found.wall_pressure, found.pressure.value, 0.03)
    assert abs(found.wall_pressure.value - found.pressure.value) < 0.01 * found.pressure.value


@kinds
def test_kicks_are_known_from_the_energy(kind):
    """At any density and number, for any masses and diameters."""
    problem = KINDS[kind]()
    found = lh.zoo.collision_statistics(problem, t1=500.0)
    agree(found.kick, kick_by_energy(problem.parameters["kinetic_energy"], freedom(problem)), 0.025)


# Equations of state.


def henderson(density):
    """D. Henderson, Mol. Phys. 30 (1975) 971, doi:10.1080/00268977500102511; to 3e-4 at the density 0.4."""
    eta = math.pi / 4 * density
    return (1 + eta**2 / 8) / (1 - eta) ** 2


def carnahan_starling(density):
    """N. F. Carnahan & K. E. Starling, J. Chem. Phys. 51 (1969) 635, doi:10.1063/1.1672048; to 2e-3 at 0.4."""
    eta = math.pi / 6 * density
    return (1 + eta + eta**2 - eta**3) / (1 - eta) ** 3


def of_finitely_many(state, density, second_virial, n):
    """Z in the ensemble of n bodies at rest as a whole, of the order 1/n.

    J. L. Lebowitz & J. K. Percus, Phys. Rev. 122 (1961) 1675, doi:10.1103/PhysRev.122.1675: the pairs at contact
    ρ² g become ρ² g - (χ ρ/2V) ∂²(ρ² g)/∂ρ², χ = ∂ρ/∂(ρZ), which is (1 - 1/n) of what uniform pairs would give.
    """

    def pairs(rho):  # ρ² g at contact
        return rho * (state(rho) - 1) / second_virial

    step = 1e-3
    second = (pairs(density + step) - 2 * pairs(density) + pairs(density - step)) / step**2
    slope = ((density + step) * state(density + step) - (density - step) * state(density - step)) / (2 * step)
    contact = (pairs(density) / density**2 - second / (2 * n * slope)) / (1 - 1 / n)
    return 1 + second_virial * density * contact


def test_uniform_pairs_need_no_correction():
    """Where Z = 1 + Bρ, g = 1: Z of n bodies is the same up to (1/n)·Bρ."""
    assert abs(of_finitely_many(lambda rho: 1 + 1e-4 * rho, 1.0, 1e-4, 10) - 1.0001) < 1e-7


def test_sixteen_disks():
    """Pressure by Henderson's equation and by the rate of collisions: Z - 1 = rate · σ √μ · kick/(2K), kick known."""
    found = lh.zoo.collision_statistics(lh.zoo.hard_disks(n=16, density=0.4), t1=300.0)
    agree(found.kick, kick_by_energy(16.0, 30), 0.015)
    by_rate = 1 + found.rate.value * math.sqrt(0.5) * kick_by_energy(16.0, 30) / 32
    assert abs(found.compressibility.value - by_rate) < 5 * found.kick.stderr / found.kick.value * (by_rate - 1)
    expected = of_finitely_many(henderson, 0.4, math.pi / 2, 16)
    agree(found.compressibility, expected, 0.012, (expected - 1) / 16**2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "state", "second_virial", "known_to"),
    [
        (lh.zoo.hard_disks, henderson, math.pi / 2, 5e-4),
        (lh.zoo.hard_spheres, carnahan_starling, 2 * math.pi / 3, 2e-3),
    ],
    ids=["disks", "spheres"],
)
def test_the_pressure_by_an_equation_of_state(make, state, second_virial, known_to):
    """Terms of the order 1/n² are left out: (Z - 1)/n² times a few. That of the order 1/n is seen."""
    found = lh.zoo.collision_statistics(make(n=32, density=0.4), t1=1500.0).compressibility
    expected = of_finitely_many(state, 0.4, second_virial, 32)
    unknown = math.hypot(known_to * expected, 5 * (expected - 1) / 32**2)
    agree(found, expected, 0.004, unknown / 5)
    assert abs(state(0.4) - expected) > unknown


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "d", "section"),
    [(lh.zoo.hard_disks, 2, 2.0), (lh.zoo.hard_spheres, 3, math.pi)],
    ids=["disks", "spheres"],
)
def test_a_dilute_gas(make, d, section):
    """Independent pairs: rate = n(n - 1)/2 · section · ⟨|w|⟩/V; the density 0.01 adds 1 % to 3 %."""
    n, density = 16, 0.01
    found = lh.zoo.collision_statistics(make(n=n, density=density), t1=20_000.0)
    f = d * (n - 1)
    relative = {2: math.pi / 2, 3: 2.0}[d] * 2 * n / kick_by_energy(n, f) * 2 / f * math.sqrt(2)  # ⟨|w|⟩
    rate = n * (n - 1) / 2 * section * relative * density / n
    virial = {2: henderson, 3: carnahan_starling}[d](density)
    contact = (virial - 1) / (density * {2: math.pi / 2, 3: 2 * math.pi / 3}[d])
    agree(found.rate, rate * contact, 0.02)
    assert abs(found.compressibility.value - virial) < 1e-3
    # Maxwell's free path 1/(√2 n section), but for the sphere of momenta of so few bodies
    assert abs(found.mean_free_path.value * math.sqrt(2) * density * section * contact - 1) < 0.15


@pytest.mark.slow
def test_sixty_four_disks():
    """Event-driven C counted 295.4(3)."""
    reference = load_event_driven()["hard_disks"]["N64_rho0.7"]
    found = lh.zoo.collision_statistics(lh.zoo.hard_disks(n=64, key=jax.random.key(4)), t1=1000.0)
    agree(found.rate, reference["collision_rate"], 0.004, reference["collision_rate_se"])
    agree(found.kick, kick_by_energy(64.0, 126), 0.003)


# How it is computed.


def test_pieces_of_any_size_give_the_same(monkeypatch):
    """No log is longer than it may be, up to the scatter of the rate; and what is counted does not depend on it."""
    problem = KINDS["mixture in a box"]()
    whole = lh.zoo.collision_statistics(problem, t1=8.0, transient=1.0, blocks=2)
    lengths = []

    def watched(*args, **keywords):
        made = lh.trajectory(*args, **keywords)
        lengths.append(len(made.events))
        return made

    monkeypatch.setattr(statistics, "trajectory", watched)
    monkeypatch.setattr(statistics, "ENTRIES", 20 * problem.x0.shape[0])
    pieces = lh.zoo.collision_statistics(problem, t1=8.0, transient=1.0, blocks=2)
    assert len(lengths) >= 6
    assert max(lengths) <= 60
    assert pieces.collisions == whole.collisions > 20
    np.testing.assert_allclose(pieces.pressure, whole.pressure, rtol=1e-5)


def test_the_error_is_the_scatter_of_runs(two_disks):
    """Of ten runs from other starts; the scatter of ten is itself known to a quarter."""
    values, errors = [], []
    for i in range(10):
        problem = lh.zoo.hard_disks(n=2, density=0.32, aspect=1, key=jax.random.key(i))
        found = lh.zoo.collision_statistics(problem, t1=1000.0, blocks=16)
        values.append([found.rate.value, found.mean_free_path.value, found.compressibility.value])
        errors.append([found.rate.stderr, found.mean_free_path.stderr, found.compressibility.stderr])
    ratio = np.std(values, axis=0, ddof=1) / np.mean(errors, axis=0)
    assert np.all((ratio > 0.4) & (ratio < 1.8)), ratio


def test_it_prints_what_was_measured(two_disks):
    text = str(two_disks)
    assert text.splitlines()[0] == f"Collisions of hard bodies (t = 30000, {two_disks.collisions} collisions)"
    assert f"mean free path   {two_disks.mean_free_path}" in text
    assert "wall" not in text
    assert text == repr(two_disks)


def test_a_run_without_collisions_has_no_free_path():
    problem = lh.zoo.hard_disks(n=2, density=0.01)
    found = lh.zoo.collision_statistics(problem, t1=1e-3, transient=0.0)
    assert found.collisions == 0
    assert math.isnan(found.mean_free_path.value)
    assert found.compressibility.value == 1.0


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"t1": -1.0}, "t1"),
        ({"t1": 1.0, "blocks": 1}, "blocks"),
        ({"t1": 1.0, "problem": lh.zoo.henon_map}, "hard_disks, hard_spheres; got 'henon_map'"),
    ],
)
def test_bad_arguments(keywords, message):
    problem = keywords.pop("problem", lh.zoo.hard_disks)()
    with pytest.raises(ValueError, match=message):
        lh.zoo.collision_statistics(problem, **keywords)


def test_the_list_of_problems_holds_problems_only():
    assert "collision_statistics" not in lh.zoo.names()
    assert lh.zoo.names()[0] == "henon_map"
    assert all(lh.zoo.get(name) for name in lh.zoo.names())
