"""Work and precision of the symplectic schemes: ``python -m benchmarks.work_precision [--out DIR]``.

What a unit of time costs, of the orbit with all its deviation vectors, against the error of the energy along the orbit
and that of the tangent map, for steps of several lengths. The scheme that is the cheapest in the mean over problems and
precisions is the default of `lh.Symplectic`.
"""

import argparse
import functools
import time
from pathlib import Path
from typing import NamedTuple, cast

import jax
import numpy as np

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid.integrators.hamiltonian.splittings import PART_B, SCHEMES

PROBLEMS = {
    "Hénon–Heiles": functools.partial(zoo.henon_heiles, y=0.55),
    "three oscillators": zoo.hamiltonian_3d,
    "FPU-β, 8 masses": zoo.fpu_beta,
}
COMPARED = (
    "leapfrog", "ForestRuth", "SABA2C", "SBAB2C", "SABA3C", "SABA4C", "SABA6", "SABA10", "ABA864", "ABA1064",
    "BlanesMoan4", "BlanesMoan6", "SRKN11b", "SRKN14a", "Yoshida6", "SuzukiUmeno8",
)  # fmt: skip
KICKS = np.geomspace(3.0, 200.0, 10)  # a unit of time: of each scheme the same, so that long schemes take long steps
LENGTH, TANGENT, ROUNDS = 1000.0, 50.0, 3  # of the runs; the tangent map's
LASTING = 0.03  # seconds, of the shorter one of two runs whose times are subtracted
LOOKS = 200  # at the energy; all are ends of steps
USEFUL = 1e-3  # error of the energy; coarser steps are left out
TARGETS = (1e-4, 1e-6, 1e-8, 1e-10)  # of the energy


class Point(NamedTuple):
    """One scheme with one step."""

    dt: float
    seconds: float  # a unit of time
    energy: float  # largest relative error along the orbit
    tangent: float  # relative error of the matrix


def kicks(scheme: str) -> int:
    """Evaluations of the force in a step; the last one of a step that begins with it is the first of the next."""
    parts = SCHEMES[scheme].parts
    return sum(part == PART_B for part, _ in parts) - (parts[0][0] == PART_B)


def steps(scheme: str) -> list[float]:
    """Steps that end where the energy is looked at, for so many kicks a unit of time."""
    between = LENGTH / LOOKS
    return sorted({float(between / np.ceil(between * rate / kicks(scheme))) for rate in KICKS}, reverse=True)


def energy_error(problem: zoo.Problem, method) -> float:
    """The largest relative error of the energy at the ends of the steps; inf where the orbit escapes."""
    system = cast(lh.Hamiltonian, problem.system)
    path = lh.trajectory(system, problem.x0, problem.args, t1=LENGTH, n=LOOKS, method=method, throw=False)
    if path.status.failed:
        return np.inf
    energies = np.asarray(jax.vmap(lambda x: system.energy(x, problem.args))(path.x))
    return float(np.max(np.abs(energies / energies[0] - 1)))


@functools.cache
def exact_tangent(name: str) -> np.ndarray:
    """The fundamental matrix, to many digits."""
    problem = PROBLEMS[name]()
    method = lh.RungeKutta(rtol=1e-13, atol=1e-15)
    return np.asarray(lh.tangent_map(problem.system, problem.x0, problem.args, t1=TANGENT, method=method).matrix)


def tangent_error(name: str, problem: zoo.Problem, method) -> float:
    """The relative error of the fundamental matrix."""
    exact = exact_tangent(name)
    found = lh.tangent_map(problem.system, problem.x0, problem.args, t1=TANGENT, method=method).matrix
    return float(np.linalg.norm(np.asarray(found) - exact) / np.linalg.norm(exact))


def cost(problem: zoo.Problem, method) -> float:
    """Seconds for a unit of time of the orbit and all its deviation vectors, without what each call costs.

    Infinite if the orbit escapes in the longer run.
    """

    def fastest(t1: float) -> float:
        taken = []
        for _ in range(ROUNDS + 1):
            start = time.perf_counter()
            lost = problem.spectrum(method=method, t1=t1, blocks=2, throw=False).status.failed
            if lost:  # by coarse steps, in the long run
                return np.inf
            taken.append(time.perf_counter() - start)
        return min(taken[1:])

    t1 = LENGTH
    while (short := fastest(t1)) < LASTING:
        t1 *= 4
    return (fastest(4 * t1) - short) / (3 * t1) if short < np.inf else np.inf


def measure(name: str, scheme: str) -> list[Point]:
    """A scheme on a problem, with all its steps that are of use."""
    problem, points = PROBLEMS[name](), []
    for dt in steps(scheme):
        method = lh.Symplectic(scheme, dt=dt)
        error = energy_error(problem, method)
        seconds = cost(problem, method) if error < USEFUL else np.inf
        if seconds < np.inf:
            points.append(Point(dt, seconds, error, tangent_error(name, problem, method)))
    jax.clear_caches()
    return points


def cost_of(points: list[Point], target: float) -> float:
    """Seconds a unit of time at which the energy is as good as wanted, between two points; inf where it never is."""
    best = np.inf
    for coarse, fine in zip(points, points[1:], strict=False):
        if fine.energy <= target < coarse.energy:
            share = np.log(coarse.energy / target) / np.log(coarse.energy / fine.energy)
            best = min(best, float(coarse.seconds ** (1 - share) * fine.seconds**share))
    if points and points[0].energy <= target:
        best = min(best, points[0].seconds)
    return best


def ratios(found: dict[str, dict[str, list[Point]]]) -> dict[str, list[float]]:
    """For each scheme and target its cost over the cheapest one's, the geometric mean over problems; best first."""
    logs: dict[str, list[float]] = {}
    for scheme in next(iter(found.values())):
        logs[scheme] = []
        for target in TARGETS:
            each = []
            for by_scheme in found.values():
                best = min(cost_of(points, target) for points in by_scheme.values())
                each.append(np.log(cost_of(by_scheme[scheme], target) / best))
            logs[scheme].append(float(np.mean(each)))
    return {s: [float(np.exp(v)) for v in row] for s, row in sorted(logs.items(), key=lambda item: sum(item[1]))}


def figure(found: dict[str, dict[str, list[Point]]]):
    """Energy above, tangent map below; a column for each problem."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    made = Figure(figsize=(4.2 * len(found) + 1.6, 8.0), layout="constrained")
    axes = made.subplots(2, len(found), squeeze=False, sharex="col", sharey="row")
    best = set(list(ratios(found))[:3])
    for column, (name, by_scheme) in enumerate(found.items()):
        for i, (scheme, points) in enumerate(by_scheme.items()):
            style = {"color": colormaps["tab20"](i), "label": scheme, "marker": ".", "markersize": 4}
            style["linewidth"] = 2.2 if scheme in best else 0.9
            seconds = [1e9 * point.seconds for point in points]
            axes[0, column].loglog(seconds, [point.energy for point in points], **style)
            axes[1, column].loglog(seconds, [point.tangent for point in points], **style)
        axes[0, column].set_title(name, fontsize="medium")
        axes[1, column].set_xlabel("ns a unit of time, with all deviation vectors")
    axes[0, 0].set_ylabel(f"relative error of the energy, t ≤ {LENGTH:g}")
    axes[1, 0].set_ylabel(f"relative error of the tangent map, t = {TANGENT:g}")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside right center", frameon=False, fontsize="small")
    return made


def main(argv: list[str] | None = None) -> None:
    """The table and the figure."""
    parser = argparse.ArgumentParser("python -m benchmarks.work_precision", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="folder of the figure")
    options = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    found = {name: {scheme: measure(name, scheme) for scheme in COMPARED} for name in PROBLEMS}
    print("cost over the cheapest, mean over problems, by the error of the energy; last: mean of these")
    print(f"{'':13s}" + "".join(f"{target:>9.0e}" for target in TARGETS))
    for scheme, row in ratios(found).items():
        mean = float(np.exp(np.mean(np.log(row))))
        print(f"{scheme:13s}" + "".join(f"{value:9.2f}" if value < np.inf else f"{'—':>9s}" for value in [*row, mean]))
    options.out.mkdir(parents=True, exist_ok=True)
    figure(found).savefig(options.out / "work_precision.png", dpi=150)


if __name__ == "__main__":
    main()
