"""What must hold of the reproduction of Skokos & Gerlach: laws of motion, which no implementation can bend."""

from typing import TYPE_CHECKING

import numpy as np

from .. import zoo

if TYPE_CHECKING:
    from . import skokos

__all__ = ["checks", "law", "level", "slopes"]

ONE_OVER_T = 30.0  # t λ₁ of a regular orbit stays below: it is the logarithm of a power of t
# Of λ₁ at τ = 0.05, as an independent C program finds them over [1e5, 1e6].
LEVELS = {"TDHcc": 1.546e-3, "TDHes": 1.546e-3, "TDHeps": 7.75e-5}  # of R1
LEVEL_OF_R2 = 4.91e-5  # by TDHeps
FACTOR = 1.5  # around them
PAIRED = 10.0  # t |λ_i + λ_{2N+1−i}| of vectors that begin in no special direction
EQUAL = 3.0  # |ln GALI_2 + (λ₁ − λ₂) t|
WITHIN = 5.0  # standard errors
RATIOS = 0.03  # of ln GALI_k in chaos
SLOPES = {"R1": 0.3, "R2": 0.3, "R3": 0.5}
DECADES = {"R1": 2, "R2": 2, "R3": 1}  # at the end, over which slopes are taken
ENERGY = {"DOP853": 1e-9, "TM": 2e-7}
ISLANDS, SMALL = 5, 0.2  # of R1 on its section, and the size of each
WEAK = (20.0, 1e-3)  # t λ₁ of C2 is above the first, where a torus beside it has 8; and λ₁ below the second


def law(orbit: "skokos.Orbit") -> list[int]:
    """Exponents of t in GALI_2 … GALI_2N on a torus of s dimensions, N degrees of freedom; equation (17)."""
    n, s = orbit.freedoms, orbit.torus
    assert s is not None
    return [0 if k <= s else s - k if k <= 2 * n - s else 2 * (n - k) for k in orbit.orders]


def slopes(found, decades: int) -> np.ndarray:
    """The powers of t, d ln GALI_k / d ln t, by least squares over the last decades."""
    time, logs = np.asarray(found.time), np.asarray(found.log_values)
    late = time >= time[-1] / 10**decades * (1 - 1e-9)
    return np.polyfit(np.log(time[late]), logs[late], 1)[0]


def level(run: "skokos.Run") -> float:
    """The rate d(t λ₁)/dt over the last decade: where λ₁ levels off; near 0 where it falls as 1/t."""
    product = run.time * run.exponents[:, 0]
    first = int(np.searchsorted(run.time, 0.1 * run.time[-1] * (1 - 1e-9)))
    return float((product[-1] - product[first]) / (run.time[-1] - run.time[first]))


def checks(r: "skokos.Reproduction") -> dict[str, bool]:
    """What must hold, by name."""
    found = {}
    for part in (_islands, _regular, _rivals, _pairs, _on_tori, _in_chaos):
        found |= part(r)
    return {name: bool(holds) for name, holds in found.items()}


def _islands(r: "skokos.Reproduction"):
    x = np.asarray(r.sections["R1"].x)[:, [1, 3]]
    sizes = [np.ptp(x[i::ISLANDS], axis=0).max() for i in range(ISLANDS)]
    scattered = np.asarray(r.sections["C1"].x)[:, [1, 3]]
    return {
        "Fig. 1: R1 visits five islands in turn": max(sizes) < SMALL,
        "Fig. 1: C1 is scattered": min(np.ptp(scattered[i::ISLANDS], axis=0).max() for i in range(ISLANDS)) > SMALL,
    }


def _regular(r: "skokos.Reproduction"):
    from . import skokos

    found = {}
    for method in skokos.SURE:
        for orbit in ("R1", "R2"):
            run = r.of(orbit)[method]
            found[f"{method}: λ1 of {orbit} falls as 1/t"] = run.exponents[-1, 0] * run.time[-1] < ONE_OVER_T
        found[f"{method}: energy at τ = 0.05 within {ENERGY[method]:.0e}"] = r.of_r1(method).energy <= ENERGY[method]
    return found


def _rivals(r: "skokos.Reproduction"):
    found = {}
    for method, expected in LEVELS.items():
        value = level(r.of_r1(method))
        found[f"{method}: λ1 of R1 levels off near {expected:.1e}"] = expected / FACTOR < value < expected * FACTOR
    ratio = level(r.of_r1("TDHeps", 0.1)) / level(r.of_r1("TDHeps"))
    found["TDHeps: the level goes with τ²"] = abs(ratio - 4) <= 0.4
    value = level(r.of("R2")["TDHeps"])
    name = f"TDHeps: λ1 of R2 levels off near {LEVEL_OF_R2:.1e}"
    found[name] = LEVEL_OF_R2 / FACTOR < value < LEVEL_OF_R2 * FACTOR
    return found


def _pairs(r: "skokos.Reproduction"):
    """All five tangents are symplectic."""
    return {
        f"{orbit}: exponents come in pairs by every method": all(
            np.max(np.abs(run.sums[-1])) * run.time[-1] < PAIRED for run in r.of(orbit).values()
        )
        for orbit in ("R1", "C1", "C2", "R2")
    }


def _on_tori(r: "skokos.Reproduction"):
    from . import skokos

    found = {}
    for name, tolerance in SLOPES.items():
        orbit = skokos.ORBITS[name]
        for method in skokos.SURE:
            seen = slopes(r.indices[name][method], DECADES[name])
            found[f"{method}: GALIs of {name} follow the powers of t"] = np.max(np.abs(seen - law(orbit))) < tolerance
    for method in LEVELS:
        run, logs = r.of_r1(method), r.indices["R1"][method]
        at = int(np.searchsorted(run.time, float(logs.time[-1]) * (1 - 1e-9)))
        fall = float((run.exponents[at, 0] - run.exponents[at, 1]) * run.time[at])
        found[f"{method}: GALI_2 of R1 falls as exp(−(λ1 − λ2) t)"] = abs(float(logs.log_values[-1, 0]) + fall) < EQUAL
    return found


def _in_chaos(r: "skokos.Reproduction"):
    from . import skokos

    known, found = zoo.henon_heiles().reference, {}
    assert known is not None
    for method, run in r.of("C1").items():
        error = np.hypot(run.error, known.stderr[0])
        found[f"{method}: λ1 of C1 within 5 standard errors"] = (
            abs(run.exponents[-1, 0] - known.exponents[0]) <= WITHIN * error
        )
    for method, logs in r.indices["C1"].items():
        two, three, four = np.asarray(logs.log_values)[-1]
        off = max(abs(three - 2 * two) / 2, abs(four - 4 * two) / 4)
        found[f"{method}: ln GALI_k of C1 are as 1 : 2 : 4"] = two < 0 and off < -RATIOS * two
    for method in skokos.SURE:
        run = r.of("C2")[method]
        first = run.exponents[-1, 0]
        found[f"{method}: C2 is weakly chaotic"] = first * run.time[-1] > WEAK[0] and first < WEAK[1]
    return found
