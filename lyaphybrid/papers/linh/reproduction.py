"""Linh, Truong & Tuyen, On computation of Lyapunov exponents by QR methods with error control (2025): Tables 1 to 10.

Two differential–algebraic systems: a damped spring (Example 5.1), and the same in turning coordinates (Example 5.2),
slowly, γ = (1, 2, 3), and fast, γ = (20, 100, 200). Their finite-time exponents are known, λ_i(T) = λ_i + C_i/T, and
every row of every table is compared with them. Beside the tables: the same spring as an ordinary differential equation
(Remark 5.3), the error of the linearisation (Theorem 4.1), the orders of the half-explicit method with and without the
reformulation (9), and what the paper names but does not compute.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...analysis.indicators.following import follow
from ...analysis.spectra import lyapunov_spectrum
from ...analysis.trajectories import trajectory
from ...integrators import HalfExplicit, RungeKutta
from ...integrators.base import Method
from ...systems.smooth import Flow
from .. import reproductions
from ..claims import Check, Claim
from ..reproductions import computed, write
from . import checks as linh_checks
from . import claims as linh_claims
from . import report as linh_report
from . import theory as linh_theory
from .beyond import extensions as linh_extensions
from .beyond import extensions_report
from .intervals import Intervals, intervals
from .orders import EXPONENT_ORDERS, ORDERS, errors_at_end, errors_of_exponents
from .rectangle import RightRectangle
from .tables import (
    EXAMPLES,
    OF_TABLES,
    OFFSETS,
    SHORTEST_LENGTH,
    TOLERANCES,
    PublishedRow,
    PublishedTable,
    algorithm,
    exact,
    frame_at_start,
    problem_of,
    rows_of,
)

__all__ = ["FULL", "QUICK", "RowResults", "Linearisation", "Ordinary", "Reproduction", "reproduce", "write"]

FULL, QUICK = (1000, 5000, 10000), (1000,)  # lengths of the runs
QUICK_LENGTH = 200.0  # with --quick, instead of SHORTEST_LENGTH
RUNNING_TOLERANCE = 1e-8  # TOL of the running exponents
BRIEF = 0.2  # in seconds: shorter runs are timed five times
FIGURES = ("errors", "orders", "convergence", "linearisation")
EXTENSION_ALGORITHMS = ("collocation", "continuous_esdirk", "svd", "bounds")  # extensions
SYSTEMS = {"5.1": "semi-explicit", "5.2": "turning", "5.2 fast": "turning"}


@dataclasses.dataclass(frozen=True)
class RowResults:
    """The computed results of a row.

    Attributes:
        exponents: (2,); steps: accepted ones, with the two that end the halves of the run.
        seconds: of a run with everything compiled, not in parallel with anything.
        intervals: [λ^l, λ^u] and Steklov differences, of another run.
    """

    exponents: np.ndarray
    steps: int
    seconds: float
    intervals: Intervals


@dataclasses.dataclass(frozen=True)
class Ordinary:
    """Example 5.1 as an ordinary differential equation, discrete QR.

    Attributes:
        tolerance: TOL; length: T.
        exponents: (2,); seconds: of the run.
        of_dae: of Example 5.1 as it stands; of_turning: of Example 5.2, γ = (1, 2, 3).
    """

    tolerance: float
    length: float
    exponents: np.ndarray
    seconds: float
    of_dae: float
    of_turning: float


@dataclasses.dataclass(frozen=True)
class Linearisation:
    """Theorem 4.1 on Example 5.1: the linear equation along a computed motion and along the exact one.

    Attributes:
        distance: (tolerances,) ε, the largest distance of the two motions.
        difference: (tolerances,) max |f_x(ψ) − f_x(φ)|, Frobenius norms.
        bound: (tolerances,) N = max |f_xx| over both motions.
    """

    distance: np.ndarray
    difference: np.ndarray
    bound: np.ndarray


@dataclasses.dataclass(frozen=True)
class Reproduction(reproductions.Reproduction):
    """Tables 1 to 10 and further results, computed and compared.

    Attributes:
        lengths: T of the rows.
        found: a `RowResults` for each of `rows`.
        accuracy: for each example and algorithm |λ − exact| (tolerances, 2), by `TOLERANCES`.
        rectangle: for each example λ (3, 2) at T = 1000 by the quadrature of the paper's continuous tables.
        running: for each algorithm times and λ(t) (times, 2) of Example 5.1.
        ordinary: Remark 5.3, at three tolerances.
        linearisation: Theorem 4.1, by `TOLERANCES`.
        orders: for each of `ORDERS` the error of x(1) by `COUNTS`.
        exponent_orders: for each of `EXPONENT_ORDERS` that of λ_i(1).
        initial: ln R_ii at t₀.
        characteristic: Λ of (7) on Example 5.1.
        turning: Theorem 4.1 with M δ, on Example 5.2.
        perturbed: Definition 2.3, on Example 5.1 at rest.
        state_alone: (2,) λ of Example 5.1 at T = 1000, TOL = 1e-6, where the error of x alone is controlled.
        extensions: methods and equations that the paper names but does not compute.
    """

    name = "linh"

    lengths: tuple[int, ...]
    found: tuple[RowResults, ...]
    accuracy: dict[tuple[str, str], np.ndarray]
    rectangle: dict[str, np.ndarray]
    running: dict[str, tuple[np.ndarray, np.ndarray]]
    ordinary: tuple[Ordinary, ...]
    linearisation: Linearisation
    orders: dict[str, np.ndarray]
    exponent_orders: dict[str, np.ndarray]
    initial: np.ndarray
    state_alone: np.ndarray
    characteristic: linh_theory.Characteristic
    turning: linh_theory.Turning
    perturbed: linh_theory.Perturbed
    extensions: linh_extensions.Extensions

    @property
    def rows(self) -> tuple[PublishedRow, ...]:
        """The published rows of these lengths."""
        return rows_of(self.lengths)

    def of(self, table: PublishedTable) -> list[tuple[PublishedRow, RowResults]]:
        """The rows of a table, published and computed."""
        return [pair for pair in zip(self.rows, self.found, strict=True) if pair[0].table == table]

    def compared(self) -> list[Check]:
        """All checks."""
        return [*linh_checks.checks(self), *extensions_report.checks(self.extensions)]

    def judged(self) -> list[Claim]:
        """The claims of the paper, item by item, with the findings."""
        return [*linh_claims.claims(self), *extensions_report.claims(self.extensions)]

    def report(self) -> str:
        """Tables, checks and claims."""
        return linh_report.table(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return linh_report.numbers(self)

    def figures(self) -> dict:
        """All figures by the names of their files."""
        return {f"linh-{name}": self.figure(name) for name in FIGURES}

    def figure(self, name: str = "errors"):
        """The figure "errors", "orders", "convergence" or "linearisation"."""
        from . import figures as linh_figures

        return linh_figures.figure(self, name)


# Tables.


class Steps:
    """An observer that counts orthonormalisations, one after each accepted step."""

    def init(self, t, frame):
        """The count starts at zero."""
        return jnp.zeros((), jnp.int32)

    def update(self, state, seen):
        """Add one."""
        return state + 1

    def moved(self, state, source):
        """Unchanged."""
        return state

    def next_block(self, state):
        """Unchanged."""
        return state


STEP_COUNTER = Steps()


def _count(t, carry):
    return carry.observer


def _steps(example: str, method: Method, length: float) -> int:
    """The number of accepted steps."""
    system, x0, args = problem_of(example)
    seen = follow(
        STEP_COUNTER, _count, system, x0, args, k=2, t1=float(length), t0=0.0, transient=0.0, times=None, blocks=2,
        mode=None, frame=frame_at_start(example)[0], method=method, max_steps=None, progress=None, each_step=True,
    )  # fmt: skip
    return int(seen.collected[-1])


def _exponents(example: str, method: Method, length: float, *, counted: bool = False) -> np.ndarray:
    system, x0, args = problem_of(example)
    spectrum = lyapunov_spectrum(system, x0, args, t1=length, method=method, blocks=2, count_start=counted)
    return np.asarray(spectrum.exponents)


def _of_row(row: PublishedRow) -> np.ndarray:
    table = row.table
    return _exponents(
        table.example, table.method(row.tolerance), float(row.length), counted=table.algorithm == "discrete"
    )


def _timed(run: Callable) -> tuple[Any, float]:
    """The result of a compiled run and its time; for a short run the shortest of five."""
    taken, result = [], None
    while not taken or (len(taken) < 5 and max(taken) < BRIEF):
        start = time.perf_counter()
        result = run()
        taken.append(time.perf_counter() - start)
    return result, min(taken)


# Further results.


def _state_alone() -> np.ndarray:
    return _exponents(
        "5.1", HalfExplicit(rtol=OF_TABLES[-1], control="x", atol=OF_TABLES[-1]), SHORTEST_LENGTH, counted=True
    )


def _accuracy(example: str, name: str, length: float) -> np.ndarray:
    runs = [_exponents(example, algorithm(name, tol), length, counted=name == "discrete") for tol in TOLERANCES]
    return np.abs(np.stack(runs) - exact(name, length))


def _rectangle(example: str) -> np.ndarray:
    return np.stack(
        [_exponents(example, RightRectangle(HalfExplicit(rtol=tol, atol=tol)), SHORTEST_LENGTH) for tol in OF_TABLES]
    )


def _running(name: str) -> tuple[np.ndarray, np.ndarray]:
    system, x0, args = problem_of("5.1")
    spectrum = lyapunov_spectrum(
        system, x0, args, t1=SHORTEST_LENGTH, times=np.geomspace(1.0, SHORTEST_LENGTH, 91),
        method=algorithm(name, RUNNING_TOLERANCE), count_start=name == "discrete",
    )  # fmt: skip
    return np.asarray(spectrum.history.time), np.asarray(spectrum.history.exponents)


def spring(t, x, args):
    """Example 5.1 with x₃ = x₂/r, and x₄ from the other constraint."""
    mass, damping, lever = args["mass"], args["damping"], args["radius"] ** 2 / args["inertia"]
    pull = (args["stiffness"] * x[0] + args["cubic"] * x[0] ** 3) / mass
    force = (pull - (2 * lever - 1 / mass) * damping * x[1]) / (lever + 1 / mass)
    return jnp.stack([x[1], -pull - damping / mass * x[1] + force / mass])


def _ordinary(length: float, seconds: dict[tuple[int, float], float]) -> tuple[Ordinary, ...]:
    """Remark 5.3; `seconds` of the DAEs by table and tolerance."""
    _, x0, args = problem_of("5.1")
    flow, found = Flow(spring), []

    def run(tolerance, length):
        method = RungeKutta("dopri5", rtol=tolerance, atol=tolerance)
        return np.asarray(lyapunov_spectrum(flow, x0[:2], args, t1=length, method=method, blocks=2).exponents)

    run(OF_TABLES[0], length)
    for tolerance in OF_TABLES:
        exponents, taken = _timed(functools.partial(run, tolerance, length))
        of_daes = seconds[1, tolerance], seconds[5, tolerance]
        found.append(Ordinary(tolerance, length, exponents, taken, *of_daes))
    return tuple(found)


def _linearisation() -> Linearisation:
    """Compared at twenty times, so far apart that steps are limited by the tolerance only."""
    system, x0, args = problem_of("5.1")

    def path(tolerance):
        return trajectory(system, x0, args, t1=20.0, n=20, method=HalfExplicit(rtol=tolerance, atol=tolerance)).x

    def first(x):
        return jax.jacfwd(lambda x: system.field.residual(jnp.zeros(()), x, args))(x)

    def size(tensors):
        return np.sqrt(np.sum(np.asarray(tensors).reshape(len(tensors), -1) ** 2, axis=1)).max()

    derivatives, curvatures = jax.vmap(first), jax.vmap(jax.jacfwd(first))
    true, found = path(1e-13), []
    for tolerance in TOLERANCES:
        near = path(tolerance)
        bound = max(size(curvatures(true)), size(curvatures(near)))  # linear in x, so the maximum is at an end
        found.append((size(near - true), size(derivatives(near) - derivatives(true)), bound))
    return Linearisation(*np.array(found).T)


# All.


def reproduce(*, quick: bool = False, progress=None) -> Reproduction:
    """Compute Tables 1 to 10 and the further results.

    Args:
        quick: only the rows with T = 1000, and errors against tolerance at T = 200; nothing else changes.
        progress: a function of the fraction done.

    Returns:
        A `Reproduction`.
    """
    lengths = QUICK if quick else FULL
    rows = rows_of(lengths)
    done = computed(_tasks(rows, QUICK_LENGTH if quick else SHORTEST_LENGTH), progress)
    timed = [_timed(functools.partial(_of_row, row)) for row in rows]  # not in parallel with anything
    found = tuple(
        RowResults(value, done["steps", row], s, done["intervals", row])
        for row, (value, s) in zip(rows, timed, strict=True)
    )
    seconds = {
        (row.table.number, row.tolerance): one.seconds
        for row, one in zip(rows, found, strict=True)
        if row.length == lengths[-1]
    }
    return Reproduction(
        lengths,
        found,
        {pair: done["accuracy", *pair] for pair in itertools.product(EXAMPLES, OFFSETS)},
        {example: done["rectangle", example] for example in EXAMPLES},
        {name: done["running", name] for name in OFFSETS},
        _ordinary(float(lengths[-1]), seconds),
        done["linearisation",],
        {name: done["orders", name] for name in ORDERS},
        {name: done["exponent orders", name] for name in EXPONENT_ORDERS},
        frame_at_start("5.1")[1],
        done["state alone",],
        *(done[name,] for name in ("characteristic", "turning", "perturbed")),
        extensions=linh_extensions.Extensions(
            **{
                part: {example: done[part, example] for example in linh_extensions.BOTH}
                for part in EXTENSION_ALGORITHMS
            },
            implicit=done["implicit",],
            large=done["large",],
        ),
    )


def _tasks(rows, length: float) -> dict[tuple, tuple]:
    """The tasks by name, each as the compiled program that it needs, the function, and its arguments."""
    tasks = {}
    for example in reversed(EXAMPLES):  # the longest first
        kind = SYSTEMS[example]
        for name in OFFSETS:
            tasks["accuracy", example, name] = ((name, kind), _accuracy, example, name, length)
        tasks["rectangle", example] = (("rectangle", kind), _rectangle, example)
    for row in rows:
        table = row.table
        program = table.algorithm, table.tableau, SYSTEMS[table.example]
        tasks["steps", row] = (("steps", *program), _steps, table.example, table.method(row.tolerance), row.length)
        tasks["intervals", row] = (("intervals", *program), intervals, row)
        if table.tableau != "dopri5" and row.length == rows[0].length:  # compile what is timed later
            tasks["compiled", row] = (program, _of_row, row)
    for name in ORDERS:
        tasks["orders", name] = (name, errors_at_end, name)
    for name in EXPONENT_ORDERS:
        tasks["exponent orders", name] = (("exponent orders", name), errors_of_exponents, name)
    for name in OFFSETS:
        tasks["running", name] = (("running", name), _running, name)
    tasks["state alone",] = ("state alone", _state_alone)
    for name, example in itertools.product(EXTENSION_ALGORITHMS, linh_extensions.BOTH):
        tasks[name, example] = ((name, SYSTEMS[example]), getattr(linh_extensions, name), example)
    theory = (linh_theory.characteristic, linh_theory.turning, linh_theory.perturbed)
    for function in (*theory, linh_extensions.implicit, linh_extensions.large):
        tasks[function.__name__,] = (function.__name__, function)
    tasks["linearisation",] = ("linearisation", _linearisation)
    return tasks
