"""The checks of the reproduction of Skokos & Gerlach: laws of motion that hold for every implementation."""

from typing import TYPE_CHECKING

import numpy as np

from ... import zoo
from ..claims import Check
from .cases import METHODS, ORBITS, TRUSTED_METHODS, PaperOrbit

if TYPE_CHECKING:
    from . import reproduction as skokos

__all__ = ["checks", "early", "growth_of_energy", "law", "level", "paired", "slopes"]

ONE_OVER_T = 30.0  # bound of t λ₁ for a regular orbit, the logarithm of a power of t
# Values at which λ₁ levels off for τ = 0.05, by an independent C program over [1e5, 1e6].
LEVELS = {"TDHcc": 1.546e-3, "TDHes": 1.546e-3, "TDHeps": 7.75e-5}  # of R1
LEVEL_OF_R2 = 4.91e-5  # by TDHeps
FACTOR = 1.5  # allowed factor around these values
PAIRED = 10.0  # bound of t |λ_i + λ_{2N+1−i}| for vectors in generic directions
EQUAL = 3.0  # bound of |ln GALI_2 + (λ₁ − λ₂) t|
WITHIN = 5.0  # standard errors
RATIOS = 0.03  # relative error of ratios of ln GALI_k in chaos
LARGEST_SLOPES = {"R1": 0.3, "R2": 0.3, "R3": 0.5}
DECADES = {"R1": 2, "R2": 2, "R3": 1}  # last decades of time, over which slopes are fitted
ENERGY = {"DOP853": 1e-9, "TM": 2e-7}
GROWS, STANDS = 0.5, 0.3  # least power of t of a growing energy error, largest of a bounded one
ISLANDS, LARGEST_ISLAND = 5, 0.2  # number of islands of R1 on its section, and their largest size
WEAK = (20.0, 1e-3)  # bounds of C2: least t λ₁ (a nearby torus has 8), largest λ₁
FROZEN = ("TDHcc", "TDHes")  # methods that freeze coefficients at the start of a step
COMPARED_AT = 1e5  # time at which C2 is compared; later λ₁ fluctuates with every method
CALM, FALLEN = -20.0, -40.0  # log10 GALI_4 of C2 at that time: least with frozen coefficients, largest by DOP853 and TM


def law(orbit: PaperOrbit) -> list[int]:
    """Exponents of t in GALI_2 … GALI_2N on a torus of s dimensions, N degrees of freedom; equation (17)."""
    n, s = orbit.freedoms, orbit.torus
    assert s is not None
    return [0 if k <= s else s - k if k <= 2 * n - s else 2 * (n - k) for k in orbit.orders]


def slopes(found, decades: int) -> np.ndarray:
    """The powers of t, d ln GALI_k / d ln t, by least squares over the last decades."""
    time, logs = np.asarray(found.time), np.asarray(found.log_values)
    late = time >= time[-1] / 10**decades * (1 - 1e-9)
    return np.polyfit(np.log(time[late]), logs[late], 1)[0]


def level(run: "skokos.MethodRun", i: int = 0) -> float:
    """The rate d(t λ_i)/dt over the last decade: the value at which λ_i levels off; near 0 if it falls as 1/t."""
    product = run.time * run.exponents[:, i]
    first = int(np.searchsorted(run.time, 0.1 * run.time[-1] * (1 - 1e-9)))
    return float((product[-1] - product[first]) / (run.time[-1] - run.time[first]))


def paired(run: "skokos.MethodRun") -> float:
    """The largest t |λ_i + λ_{2N+1−i}| at the end: bounded where the tangent is symplectic."""
    return float(np.max(np.abs(run.sums[-1])) * run.time[-1])


def growth_of_energy(run: "skokos.MethodRun") -> float:
    """The power of t of the growth of the energy error, from the last two decades."""
    size, last = np.abs(run.drift), run.time[-1]
    decades = [(run.time > last / 10 ** (i + 1)) & (run.time <= last / 10**i) for i in (1, 0)]
    before, after = (float(np.median(size[decade])) for decade in decades)
    return float(np.log10(after / before))


def early(time, values):
    """The values at t = 1e5, where C2 is compared."""
    return np.asarray(values)[int(np.searchsorted(np.asarray(time), COMPARED_AT * (1 - 1e-9)))]


def checks(r: "skokos.Reproduction") -> list[Check]:
    """All checks of the reproduction."""
    return [
        one for part in (_islands, _energy, _regular, _rivals, _pairs, _on_tori, _in_chaos, _weak) for one in part(r)
    ]


def _near(name: str, expected: float, value: float) -> Check:
    holds = expected / FACTOR < value < expected * FACTOR
    return Check(name, f"{expected:.2e}, by a factor of {FACTOR:g}", f"{value:.2e}", holds)


def _below(name: str, most: float, value: float) -> Check:
    return Check(name, f"below {most:.3g}", f"{value:.3g}", bool(value < most))


def _islands(r: "skokos.Reproduction"):
    size = {
        name: [np.ptp(np.asarray(r.sections[name].x)[i::ISLANDS, [1, 3]], axis=0).max() for i in range(ISLANDS)]
        for name in ("R1", "C1")
    }
    yield _below("Fig. 1: each fifth point of R1 lies on one island, of this size", LARGEST_ISLAND, max(size["R1"]))
    least = min(size["C1"])
    yield Check(
        "Fig. 1: those of C1 are scattered", f"above {LARGEST_ISLAND}", f"{least:.3g}", bool(least > LARGEST_ISLAND)
    )


def _energy(r: "skokos.Reproduction"):
    for method in TRUSTED_METHODS:
        yield _below(f"{method}: energy error at τ = 0.05", ENERGY[method], r.of_r1(method).energy)
    for method, step in (("TM", 0.05), ("TM", 0.2), ("TDHeps", 0.05), ("DOP853", 0.2)):
        power = growth_of_energy(r.of_r1(method, step))
        drifts = method == "DOP853"
        yield Check(
            f"{method}: energy error at τ = {step:g}, power of t",
            f"above {GROWS}" if drifts else f"within ± {STANDS}",
            f"{power:.2f}",
            bool(power > GROWS if drifts else abs(power) < STANDS),
        )
    off = max(float(np.max(np.abs(r.of_r1(m).drift - r.of_r1("TM").drift))) for m in FROZEN)
    yield _below("TDHcc, TDHes: energy errors are those of TM, to", 1e-14, off)


def _regular(r: "skokos.Reproduction"):
    for method in TRUSTED_METHODS:
        for orbit in ("R1", "R2"):
            run = r.of(orbit)[method]
            yield _below(f"{method}: t λ1 of {orbit}", ONE_OVER_T, float(run.exponents[-1, 0] * run.time[-1]))


def _rivals(r: "skokos.Reproduction"):
    for method, expected in LEVELS.items():
        yield _near(f"{method}: λ1 of R1 levels off", expected, level(r.of_r1(method)))
    ratio = level(r.of_r1("TDHeps", 0.1)) / level(r.of_r1("TDHeps"))
    yield Check("TDHeps: level at τ = 0.1 over that at 0.05", "4 ± 0.4", f"{ratio:.2f}", abs(ratio - 4) <= 0.4)
    for method in FROZEN:
        second = float(np.abs(r.of_r1(method).exponents[-1, 1]) * r.of_r1(method).time[-1])
        yield _below(f"{method}: t λ2 of R1, which falls as 1/t", ONE_OVER_T, second)
    yield _near("TDHeps: λ1 of R2 levels off", LEVEL_OF_R2, level(r.of("R2")["TDHeps"]))


def _pairs(r: "skokos.Reproduction"):
    """Checks that all five tangents are symplectic."""
    for orbit in ("R1", "C1", "C2", "R2"):
        largest = max(paired(run) for run in r.of(orbit).values())
        yield _below(f"{orbit}: t |λi + λ2N+1−i| at the end, by every method", PAIRED, largest)


def _on_tori(r: "skokos.Reproduction"):
    for name, tolerance in LARGEST_SLOPES.items():
        for method in TRUSTED_METHODS:
            off = np.max(np.abs(slopes(r.indices[name][method], DECADES[name]) - law(ORBITS[name])))
            yield _below(f"{method}: powers of t of GALIs of {name}, off by", tolerance, float(off))
    for method in LEVELS:
        run, logs = r.of_r1(method), r.indices["R1"][method]
        at = int(np.searchsorted(run.time, float(logs.time[-1]) * (1 - 1e-9)))
        fall = float((run.exponents[at, 0] - run.exponents[at, 1]) * run.time[at])
        off = abs(float(logs.log_values[-1, 0]) + fall)
        yield _below(f"{method}: |ln GALI2 + (λ1 − λ2) t| of R1 at the end", EQUAL, off)


def _in_chaos(r: "skokos.Reproduction"):
    known = zoo.henon_heiles().reference
    assert known is not None
    wanted, scatter = known.exponents[0], known.stderr[0]
    for method, run in r.of("C1").items():
        first, error = float(run.exponents[-1, 0]), float(np.hypot(run.error, scatter))
        yield Check(
            f"{method}: λ1 of C1, 5 standard errors",
            f"{wanted:.5f} ± {WITHIN * error:.5f}",
            f"{first:.5f}",
            abs(first - wanted) <= WITHIN * error,
        )
    for method, logs in r.indices["C1"].items():
        two, three, four = np.asarray(logs.log_values)[-1]
        off = max(abs(three - 2 * two) / 2, abs(four - 4 * two) / 4)
        ratios = f"1 : {three / two:.2f} : {four / two:.2f}" if two < 0 else "no fall of GALI2"
        holds = bool(two < 0 and off < -RATIOS * two)
        yield Check(f"{method}: ln GALI2, 3, 4 of C1, to {100 * RATIOS:g} %", "1 : 2 : 4", ratios, holds)


def _weak(r: "skokos.Reproduction"):
    """Checks of C2: DOP853 and TM show its chaos; with frozen coefficients it looks regular for longer."""
    first = {method: r.of("C2")[method].exponents[-1, 0] for method in METHODS}
    for method in TRUSTED_METHODS:
        product = float(first[method] * r.of("C2")[method].time[-1])
        holds = bool(product > WEAK[0] and first[method] < WEAK[1])
        wanted = f"above {WEAK[0]:g}, below {WEAK[1] * r.of('C2')[method].time[-1]:g}"
        yield Check(f"{method}: t λ1 of C2", wanted, f"{product:.3g}", holds)
    then = {m: float(early(r.of("C2")[m].time, r.of("C2")[m].exponents[:, 0])) for m in METHODS}
    least = min(then[m] for m in TRUSTED_METHODS)
    for method in FROZEN:
        yield _below(f"{method}: λ1 of C2 at t = 1e5, over that of DOP853 and TM", 0.5, then[method] / least)
    fourth = {m: early(found.time, found.log_values[:, -1]) / np.log(10) for m, found in r.indices["C2"].items()}
    for method in FROZEN:
        value = float(fourth[method])
        yield Check(f"{method}: log10 GALI4 of C2 at t = 1e5", f"above {CALM:g}", f"{value:.1f}", value > CALM)
    for method in TRUSTED_METHODS:
        yield _below(f"{method}: log10 GALI4 of C2 at t = 1e5", FALLEN, float(fourth[method]))
