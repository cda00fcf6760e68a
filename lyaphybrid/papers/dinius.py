"""J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems (2011): Table I and Fig. 2.

Four hard disks in a periodic box: number density ρσ² = 0.7, L_x/L_y = √3/2, K = 4, total momentum 0,
t = 1000; here 16 runs at once, each from its own momenta. Beside the 16 exponents stands an independent
reference (event-driven C, total time 2.8e7), and what four wrong rules for perturbations at a collision
(`collisions`) give.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from .. import plots, zoo
from ..methods.scheduled import predicting_anew
from ..results import Spectrum, with_error
from ..spectra import lyapunov_spectrum
from ..systems import EventDriven
from .collisions import MISTAKES, Mistake, collide, crossing_by
from .output import plain, save

__all__ = ["MISTAKES", "Mistake", "Reproduction", "reproduce", "spectrum", "spectrum_by", "write"]

N = 4
T1, T1_QUICK = 1000.0, 100.0
T1_MISTAKES, T1_MISTAKES_QUICK = 100.0, 20.0  # of each of the runs
REPLICATES = 16
COLLISION_RATE, COLLISION_RATE_ERROR = 14.199255785714287, 5.1e-4  # the reference's
RATE_SCATTER = 0.068 * 1000**0.5  # standard deviation of the rate of one run, times √t
WITHIN = 5.0  # standard errors
ZERO = 0.01
CLOSED = 1e-9  # pairing and sum


@functools.cache
def _problem() -> zoo.Problem:
    return zoo.hard_disks(n=N)


@functools.cache
def _by_rule() -> EventDriven:
    system = _problem().system
    assert isinstance(system, EventDriven)
    return crossing_by(collide, predicting_anew(system, (4 * N,)))


def generic_frame(n: int) -> np.ndarray:
    """Orthonormal columns in dimension n that lie in no invariant subspace.

    Unit vectors do: total momentum is conserved, and only rounding would move them to where they belong.
    """
    return np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]


@jax.jit
def _starts(keys):
    return jax.vmap(lambda key: zoo.hard_disks(n=N, key=key).x0)(keys)


def _starts_for(key, replicates):
    return _starts(jax.random.split(jax.random.key(0) if key is None else key, replicates))


def spectrum(*, t1: float, key=None, replicates: int = REPLICATES, progress=None) -> Spectrum:
    """The exponents of Table I from several runs, each from its own momenta.

    Args:
        t1: length of each run after a transient of 20.
        key: a `jax.random.key`; None: key 0.
        replicates: number of runs.
        progress: as in `lh.lyapunov_spectrum`.
    """
    return _run(_problem().system, {}, replicates, key, t1=t1, transient=20.0, progress=progress)


def spectrum_by(mistake: Mistake, *, t1: float, key=None, replicates: int = REPLICATES) -> Spectrum:
    """The same with another rule at collisions.

    Args:
        mistake: one of `MISTAKES`, or another `Mistake`: the factors 1 and 1 are right.
        t1: length of each run, and of the transient before.
        key: a `jax.random.key`; None: key 0.
        replicates: number of runs.
    """
    system, factors = _by_rule(), {"jump": mistake.jump, "shift": mistake.shift}
    return _run(system, factors, replicates, key, t1=t1, transient=t1, frame=generic_frame(4 * N))


def _run(system, factors, replicates, key, **keywords) -> Spectrum:
    # As arrays the factors are traced: the four wrong rules compile once.
    args = {name: jnp.asarray(value, float) for name, value in (_problem().args | factors).items()}
    return lyapunov_spectrum(system, _starts_for(key, replicates), args, times="log", **keywords)


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """Table I and Fig. 2, computed and compared.

    Attributes:
        spectrum: the 16 exponents with their errors and history.
        mistakes: (4,) spectra by the wrong rules of `MISTAKES`.
        t1, t1_mistakes: length of each run.
    """

    spectrum: Spectrum
    mistakes: tuple[Spectrum, ...]
    t1: float
    t1_mistakes: float

    @property
    def exponents(self) -> np.ndarray:
        """(16,) per unit time."""
        return np.asarray(self.spectrum.exponents)

    @property
    def stderr(self) -> np.ndarray:
        """(16,) standard errors of the mean of the runs."""
        return np.asarray(self.spectrum.stderr)

    @property
    def deviations(self) -> np.ndarray:
        """(16,) ours less the reference, in combined standard errors; nan for the zeros."""
        return _deviations(self.spectrum, *_reference())

    @property
    def zeros(self) -> int:
        """How many exponents are below 0.01 in modulus."""
        return int(np.sum(np.abs(self.exponents) < ZERO))

    @property
    def pairing_defect(self) -> float:
        """The largest |λ_i + λ_17−i|."""
        return float(np.max(np.abs(self.exponents + self.exponents[::-1])))

    @property
    def sum(self) -> float:
        """Of all exponents."""
        return float(np.sum(self.exponents))

    @property
    def collision_rate(self) -> float:
        """Collisions per unit time."""
        return float(np.mean(self.spectrum.jumps) / np.mean(self.spectrum.time))

    @property
    def collision_rate_error(self) -> float:
        """Its standard error, from the scatter that is known for runs of this length."""
        runs = len(np.asarray(self.spectrum.replicates))
        return RATE_SCATTER / (runs * self.t1) ** 0.5

    @property
    def mistaken_deviations(self) -> np.ndarray:
        """(4,) the largest deviation from the right reference by each wrong rule, in standard errors."""
        return np.array([np.nanmax(np.abs(_deviations(s, *_reference()))) for s in self.mistakes])

    @property
    def checks(self) -> dict[str, bool]:
        """What must hold, by name."""
        rate_error = np.hypot(self.collision_rate_error, COLLISION_RATE_ERROR)
        return {
            "exponents within 5 standard errors": bool(np.nanmax(np.abs(self.deviations)) <= WITHIN),
            "exactly six zeros": self.zeros == 6,
            "pairing to 1e-9": self.pairing_defect < CLOSED,
            "sum to 1e-9": abs(self.sum) < CLOSED,
            "collision rate within 5 standard errors": bool(
                abs(self.collision_rate - COLLISION_RATE) <= WITHIN * rate_error
            ),
            "wrong rules beyond 5 standard errors": bool(np.all(self.mistaken_deviations > WITHIN)),
        }

    @property
    def passed(self) -> bool:
        """Whether all checks hold."""
        return all(self.checks.values())

    def __str__(self) -> str:
        return _report(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return _data(self)

    def figure(self):
        """Fig. 2: the spectrum above, its convergence in time below."""
        return _figure(self)


def reproduce(*, quick: bool = False, key=None, progress=None) -> Reproduction:
    """Compute Table I and what the wrong rules give.

    Args:
        quick: a tenth of the length; nothing else differs.
        key: a `jax.random.key`; None: key 0.
        progress: as in `lh.lyapunov_spectrum`.

    Returns:
        A `Reproduction`.
    """
    t1, t1_mistakes = (T1_QUICK, T1_MISTAKES_QUICK) if quick else (T1, T1_MISTAKES)
    _starts_for(key, REPLICATES)  # compiles what both threads need
    # Two threads, because the two systems would compile one after the other.
    with ThreadPoolExecutor(1) as aside:
        wrong = aside.submit(lambda: [spectrum_by(mistake, t1=t1_mistakes, key=key) for mistake in MISTAKES])
        right = spectrum(t1=t1, key=key, progress=progress)
    return Reproduction(right, tuple(wrong.result()), t1, t1_mistakes)


def write(result: Reproduction, folder: Path) -> list[Path]:
    """Figure (PNG, PDF) and numbers (JSON) into a folder; returns the files."""
    return save(folder, "dinius", {"dinius": result.figure()}, result.data())


def _reference() -> tuple[np.ndarray, np.ndarray]:
    reference = _problem().reference
    assert reference is not None
    return np.array(reference.exponents), np.array(reference.stderr)


def _deviations(found: Spectrum, values, errors) -> np.ndarray:
    combined = np.hypot(np.asarray(found.stderr), errors)
    difference = np.asarray(found.exponents) - values
    return np.where(np.abs(values) > ZERO, difference / np.where(combined > 0, combined, 1.0), np.nan)


def _number(value: float, error: float) -> str:
    """Like 4.8853(92), and a plain 0 where it is one up to rounding."""
    return "0" if abs(value) < CLOSED else with_error(value, error).replace("-", "−")


def _report(r: Reproduction) -> str:
    runs = len(np.asarray(r.spectrum.replicates))
    values, errors = _reference()
    per_jump = r.exponents / r.collision_rate
    lines = [
        f"Table I of Dinius: {N} hard disks, number density 0.7, L_x/L_y = √3/2, K = 4",
        f"t = {r.t1:g}, {runs} runs at once; in brackets one standard error in units of the last digits",
        "",
        "       exponent       reference     deviation   λ/(j/t): the paper's s = max(t, j)",
    ]
    for i, deviation in enumerate(r.deviations):
        apart = "" if np.isnan(deviation) else f"{deviation:+.1f} se".replace("-", "−")
        jump = "0" if abs(per_jump[i]) < CLOSED else f"{per_jump[i]:.4f}".replace("-", "−")
        lines.append(
            f"λ{i + 1:<3d} {_number(r.exponents[i], r.stderr[i]):>12s} {_number(values[i], errors[i]):>15s}"
            f" {apart:>11s} {jump:>11s}"
        )
    rate = with_error(r.collision_rate, r.collision_rate_error)
    lines += [
        "",
        f"zeros           {r.zeros} with |λ| < {ZERO:g} (2d + 2 = 6)",
        f"pairing         max |λ_i + λ_17−i| = {r.pairing_defect:.1e}",
        f"sum             {abs(r.sum):.1e} in modulus",
        f"collisions      {rate} per unit time; reference {with_error(COLLISION_RATE, COLLISION_RATE_ERROR)}",
        "",
        f"What wrong rules at the collisions give (t = {r.t1_mistakes:g}, {runs} runs) [reference]",
        "",
        "     " + " ".join(f"{mistake.name:>22s}" for mistake in MISTAKES),
    ]
    for i in range(4 * N):
        cells = (_cell(s, m, i) for s, m in zip(r.mistakes, MISTAKES, strict=True))
        lines.append(f"λ{i + 1:<3d} " + " ".join(f"{cell:>22s}" for cell in cells))
    lines.append("off  " + " ".join(f"{f'{d:.0f} se':>22s}" for d in r.mistaken_deviations))
    lines.append("sum  " + " ".join(f"{abs(float(np.sum(s.exponents))):>22.0e}" for s in r.mistakes))
    failed = [name for name, holds in r.checks.items() if not holds]
    largest = np.nanmax(np.abs(r.deviations))
    verdict = f"FAILED: {'; '.join(failed)}" if failed else "passed: every check holds"
    lines += ["", f"{verdict}; the largest deviation is {largest:.1f} standard errors"]
    return "\n".join(lines)


def _cell(found: Spectrum, mistake: Mistake, i: int) -> str:
    value, error = float(found.exponents[i]), float(found.stderr[i])
    decays = abs(value) < 2 / float(np.mean(found.time))  # a zero exponent, from a generic frame
    ours = "0" if decays else with_error(value, error)
    theirs = "0" if abs(mistake.exponents[i]) < ZERO else f"{mistake.exponents[i]:.3f}"
    return f"{ours} [{theirs}]".replace("-", "−")


def _data(r: Reproduction) -> dict:
    values, errors = _reference()

    return {
        "paper": "J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems, Table I",
        "parameters": dict(_problem().parameters),
        "t1": r.t1,
        "replicates": len(np.asarray(r.spectrum.replicates)),
        "status": str(r.spectrum.status),
        "exponents": plain(r.exponents),
        "stderr": plain(r.stderr),
        "error_kind": r.spectrum.error_kind,
        "reference": {"exponents": plain(values), "stderr": plain(errors)},
        "deviations": plain(r.deviations),
        "zeros": r.zeros,
        "pairing_defect": r.pairing_defect,
        "sum": r.sum,
        "collision_rate": r.collision_rate,
        "collision_rate_reference": COLLISION_RATE,
        "exponents_per_jump": plain(r.exponents / r.collision_rate),
        "mistakes": [
            {
                "name": mistake.name,
                "t1": r.t1_mistakes,
                "exponents": plain(found.exponents),
                "stderr": plain(found.stderr),
                "reference": list(mistake.exponents),
                "largest_deviation": float(off),
            }
            for mistake, found, off in zip(MISTAKES, r.mistakes, r.mistaken_deviations, strict=True)
        ],
        "checks": r.checks,
        "passed": r.passed,
    }


def _figure(r: Reproduction):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.8, 8.0), layout="constrained")
    upper, lower = figure.subplots(2, 1)
    values, _ = _reference()
    index = np.arange(1, 4 * N + 1)
    for mistake, found, colour, marker in zip(MISTAKES, r.mistakes, plots.COLOURS[1:5], "v^sD", strict=True):
        style = {"marker": marker, "markersize": 3.5, "linewidth": 0.7, "color": colour}
        upper.plot(index, found.exponents, label=mistake.name.replace("_c", "$_c$"), **style)
    upper.plot(index, values, "o", markersize=9, fillstyle="none", color="0.3", label="reference")
    plots.spectrum(r.spectrum, upper)
    upper.containers[-1].set_label("this run")
    upper.legend(frameon=False, fontsize="small", title="wrong rules:", alignment="left")
    upper.set_title(f"Table I: {N} hard disks, t = {r.t1:g}", fontsize="medium")
    plots.convergence(r.spectrum, lower)
    return figure
