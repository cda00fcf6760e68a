"""The cases: what is run, how long, and both sides of it.

Lengths make one run of the other side take about a tenth of a second; ``--quick`` divides them by four. Rounds are
short and many, for on a shared machine quiet moments are short: a neighbour on the same physical core slows down code
that keeps the core's units busy, and hardly any that waits for its own results, as the C of the Lorenz system does.
"""

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks import lattices, many_disks, problems, references
from benchmarks.harness import Make, compare

QUICK = 4
ROUNDS, QUICK_ROUNDS = 36, 6


class Case(NamedTuple):
    """One row of the table."""

    unit: str
    t1: float
    ours: Callable[[float], Make]
    reference: Callable[[float], Make]
    against: str = "c"


def _ours(name: str, *arguments, module: str = "ours") -> Callable[[float], Make]:
    """Our side by name: importing it imports JAX, which the process that collects the rows does not need."""

    def bind(t1: float) -> Make:
        return getattr(importlib.import_module(f"benchmarks.{module}"), name)(*arguments, t1)

    return bind


def _reference(run: Callable[..., references.Result], work: str, *arguments) -> Callable[[float], Make]:
    """The C side; `work` is the field of the result that counts units."""

    def bind(t1: float) -> Make:
        def warm() -> dict[str, Any]:
            result = run(t1, *arguments)
            exponents = np.sort(result.exponents)[::-1].tolist()
            return {"exponents": exponents, "events": result.events, "steps": result.steps}

        return lambda: (warm, getattr(run(t1, *arguments), work))

    return bind


def _diffrax(t1: float) -> Make:
    """The impact oscillator by an outer scan over `diffrax.diffeqsolve`, see tests/support/diffrax_events.py."""

    def make():
        from benchmarks import ours, rivals

        run = rivals.diffrax_events(ours.oscillate, ours.gap, ours.rebound, t1)
        run()
        return run, t1

    return make


def _impact_diffrax(t1: float) -> Case:
    return Case("time", t1, _ours("impact", True, problems.IMPACT_EVERY_EVENT), _diffrax, against="diffrax")


def _lorenz(every: int, t1: float) -> Case:
    return Case("step", t1, _ours("lorenz", every), _reference(references.run_lorenz, "steps", every))


def _henon_heiles(every: int, t1: float) -> Case:
    return Case("step", t1, _ours("henon_heiles", every), _reference(references.run_henon_heiles, "steps", every))


def _impact(adaptive: bool, t1: float) -> Case:
    every = problems.IMPACT_EVERY_TIME if adaptive else problems.IMPACT_EVERY
    return Case("time", t1, _ours("impact", adaptive, every), _reference(references.run_impact, "time", adaptive))


def _friction(adaptive: bool, t1: float) -> Case:
    every = problems.FRICTION_EVERY_TIME if adaptive else problems.FRICTION_EVERY
    return Case("time", t1, _ours("friction", adaptive, every), _reference(references.run_friction, "time", adaptive))


def _spring_damper(continuous: bool, t1: float) -> Case:
    run = references.run_spring_damper
    return Case("time", t1, _ours("spring_damper", continuous), _reference(run, "time", continuous))


def _spring_damper_sweep(lanes: float) -> Case:
    def reference(lanes: float) -> Make:
        def run() -> dict[str, Any]:
            result = references.run_spring_damper_sweep(round(lanes))
            return {"exponents": result.exponents.mean(axis=0).tolist(), "events": 0, "steps": result.steps}

        def make():
            run()
            return run, lanes

        return make

    return Case("lane", lanes, _ours("spring_damper_sweep"), reference)


def _swept(name: str, *arguments, lanes: int = 256) -> Case:
    """Lanes on threads against the same lanes, one after the other, on one thread of the C."""

    def reference(lanes: float) -> Make:
        (parameter, first, last), run, work = getattr(problems, f"{name.upper()}_SWEEP"), *_lane(name, *arguments)
        values = np.linspace(first, last, round(lanes))

        def once() -> dict[str, Any]:
            result = references.run_swept(lambda value: run({parameter: value}), values)
            return {"exponents": np.sort(result.exponents)[::-1].tolist(), "events": result.events}

        return lambda: (once, work * round(lanes))

    return Case(
        "step" if name in ("lorenz", "henon_heiles") else "time",
        lanes,
        _ours(name, *arguments, module="swept"),
        reference,
    )


def _lane(name: str, *arguments) -> tuple[Callable[[dict[str, float]], references.Result], float]:
    """One lane of the C by what is changed in it, and its work."""
    steps, t1 = problems.LORENZ_SWEEP_STEPS, problems.OSCILLATORS_SWEEP_T1
    if name == "lorenz":
        sigma, _, beta = problems.LORENZ_PARAMETERS
        dt = problems.LORENZ_DT
        return lambda changed: references.run_lorenz(steps * dt, 10, parameters=(sigma, changed["rho"], beta)), steps
    if name == "henon_heiles":
        (x, _, *momenta), dt = problems.HENON_HEILES_START, problems.HENON_HEILES_DT
        steps = problems.HENON_HEILES_SWEEP_STEPS
        return lambda changed: references.run_henon_heiles(steps * dt, 10, start=(x, changed["y"], *momenta)), steps
    run, args = getattr(references, f"run_{name}"), getattr(problems, f"{name.upper()}_PARAMETERS")
    adaptive, _ = arguments
    return lambda changed: run(t1, adaptive, args=args | changed), t1


def _hard_disks(t1: float) -> Case:
    return Case("collision", t1, _ours("hard_disks"), _reference(references.run_hard_disks, "steps"))


def _many_disks(n: int, every: int, collisions: int, lapack: bool = False) -> Case:
    """Disks in number; the C orthonormalises by its own block Gram–Schmidt, or by the LAPACK that JAX uses."""

    def run(collisions: float) -> references.Result:
        return many_disks.run_many_disks(n, every, collisions=round(collisions), lapack=lapack)

    return Case("collision", collisions, _ours("many_disks", n, every), _reference(run, "steps"))


def _lattice(name: str, n: int, k: int, every: int, t1: float) -> Case:
    def run(t1: float) -> references.Result:
        return lattices.run_lattice(name, n, k, every, t1)

    return Case("step", t1, _ours("lattice", name, n, k, every), _reference(run, "steps"))


CASES = {
    "lorenz_every1": _lorenz(1, 1e4),
    "lorenz_every10": _lorenz(10, 2.5e4),
    "henon_heiles_every1": _henon_heiles(1, 5e4),
    "henon_heiles_every10": _henon_heiles(10, 2e5),
    "impact_fixed": _impact(False, 2e4),
    "impact_adaptive": _impact(True, 1.25e4),
    "friction_fixed": _friction(False, 1.6e4),
    "friction_adaptive": _friction(True, 8e3),
    "hard_disks_n4": _hard_disks(2e4),
    "disks_n4": _many_disks(4, 10, 80_000),
    "disks_n4_lapack": _many_disks(4, 10, 80_000, lapack=True),
    "disks_n16": _many_disks(16, 64, 40_960),
    "disks_n16_lapack": _many_disks(16, 64, 40_960, lapack=True),
    "disks_n64": _many_disks(64, 64, 2560),
    "disks_n64_lapack": _many_disks(64, 64, 2560, lapack=True),
    "disks_n256_lapack": _many_disks(256, 64, 256, lapack=True),
    "klein_gordon_n256": _lattice("klein_gordon", 256, 1, 10, 1600),
    "klein_gordon_n256_k8": _lattice("klein_gordon", 256, 8, 10, 400),
    "schroedinger_n256": _lattice("schroedinger_lattice", 256, 1, 10, 160),
    "dae_discrete": _spring_damper(False, 7.5e4),
    "dae_continuous": _spring_damper(True, 7.5e5),
    "dae_sweep": _spring_damper_sweep(1000),
    "sweep_lorenz": _swept("lorenz", 1),
    "sweep_lorenz_2": _swept("lorenz", 2),
    "sweep_henon_heiles": _swept("henon_heiles", 1),
    "sweep_henon_heiles_2": _swept("henon_heiles", 2),
    "sweep_impact_fixed": _swept("impact", False, 1),
    "sweep_impact_fixed_2": _swept("impact", False, 2),
    "sweep_impact_adaptive": _swept("impact", True, 1),
    "sweep_impact_adaptive_2": _swept("impact", True, 2),
    "sweep_friction_fixed": _swept("friction", False, 1),
    "sweep_friction_fixed_2": _swept("friction", False, 2),
    "sweep_friction_adaptive": _swept("friction", True, 1),
    "sweep_friction_adaptive_2": _swept("friction", True, 2),
    "impact_diffrax": _impact_diffrax(2.5e3),
}


def run_case(name: str, quick: bool, sides: tuple[str, ...] = ("ours", "c")) -> dict[str, Any]:
    """Time one case in this process and return its row; the side "c" is whatever the case is against.

    Raises:
        ValueError: if there is no such case.
    """
    if name not in CASES:
        raise ValueError(f"no case {name!r}; the cases are {', '.join(CASES)}.")
    case = CASES[name]
    t1 = case.t1 / QUICK if quick else case.t1
    available = {"ours": ("ours", case.ours), "c": (case.against, case.reference)}
    makes = {name: make(t1) for name, make in (available[side] for side in sides)}
    if "c" in makes:
        references.library()  # compiled outside the times
    return compare(name, case.unit, makes, QUICK_ROUNDS if quick else ROUNDS)
