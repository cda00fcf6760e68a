"""The two examples of Linh, Truong & Tuyen, their exact exponents, and Tables 1 to 10 as published."""

import dataclasses
import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

from ... import zoo
from ...integrators import ESDIRK, ContinuousQR, HalfExplicit
from ...integrators.base import Method
from ...systems.consistency import tangent_frame
from ...systems.daes.semi_linear import DAE

__all__ = [
    "EXAMPLES", "OFFSETS", "OF_TABLES", "PUBLISHED", "SHORTEST_LENGTH", "TABLES", "TOLERANCES", "PublishedRow",
    "PublishedTable", "algorithm", "exact", "frame_at_start", "limits", "problem_of", "rows_of",
]  # fmt: skip

TOLERANCES = tuple(10.0**-k for k in range(4, 11))  # six decades of tolerances
OF_TABLES = TOLERANCES[:3]
SHORTEST_LENGTH = 1000.0  # the shortest of the tables' lengths, and that of the runs beside them
# C_i of λ_i(T) = λ_i + C_i/T, with and without ln R(t₀), by an independent program.
OFFSETS = {"discrete": (-1.897955472, 2.3684471444), "continuous": (-2.7026744283, 2.1826653662)}
EXAMPLES = {
    "5.1": "Example 5.1",
    "5.2": "Example 5.2, γ = (1, 2, 3)",
    "5.2 fast": "Example 5.2, γ = (20, 100, 200)",
}
TABLEAU = {"DOPRI5(4)": "dopri5", "ESDIRK34": "esdirk34", "ESDIRK54b": "esdirk54b"}


@functools.cache
def problem_of(example: str) -> tuple[DAE, Any, dict[str, Any]]:
    """System, start, and parameters as arrays."""
    rates = {"gamma1": 20.0, "gamma2": 100.0, "gamma3": 200.0} if example == "5.2 fast" else {}
    problem = zoo.spring_damper_dae() if example == "5.1" else zoo.rotated_dae(**rates)
    assert isinstance(problem.system, DAE)
    assert problem.args is not None
    return problem.system, problem.x0, {key: jnp.asarray(value, float) for key, value in problem.args.items()}


def frame_at_start(example: str) -> tuple[np.ndarray, np.ndarray]:
    """Q(t₀) and ln R(t₀)_ii of the columns of Ē⁻¹."""
    system, x0, args = problem_of(example)
    columns, upper = np.linalg.qr(np.asarray(tangent_frame(system, jnp.zeros(()), x0, args)))
    return columns, np.log(np.abs(np.diag(upper)))


def algorithm(name: str, tolerance: float) -> Method:
    """The discrete (3.1) or continuous (3.3) algorithm in the stages of Dormand and Prince."""
    method = HalfExplicit(rtol=tolerance, atol=tolerance)
    return ContinuousQR(method) if name == "continuous" else method


@dataclasses.dataclass(frozen=True)
class PublishedTable:
    """A table of the paper.

    Attributes:
        number: 1 … 10.
        example: one of `EXAMPLES`.
        algorithm: discrete (3.1) or continuous (3.3).
        pair: the Runge–Kutta pair of the paper.
    """

    number: int
    example: str
    algorithm: str
    pair: str

    @property
    def tableau(self) -> str:
        """The name of the pair that is run."""
        return TABLEAU[self.pair]

    def method(self, tolerance: float) -> Method:
        """The method of the table."""
        if self.tableau != "dopri5":
            return ESDIRK(self.tableau, rtol=tolerance, atol=tolerance)
        return algorithm(self.algorithm, tolerance)


@dataclasses.dataclass(frozen=True)
class PublishedRow:
    """A row of the tables as published.

    Attributes:
        table: the table that it belongs to.
        length: T; tolerance: TOL.
        exponents: λ₁ and λ₂; steps: accepted ones; seconds: of CPU time (Core i5, 2.7 GHz, Matlab R2022a).
    """

    table: PublishedTable
    length: int
    tolerance: float
    exponents: tuple[float, float]
    steps: int
    seconds: float

    @property
    def exact(self) -> np.ndarray:
        """The finite-time exponents."""
        return exact(self.table.algorithm, self.length)


_TEXTS = {
    PublishedTable(1, "5.1", "discrete", "DOPRI5(4)"): """
        1000 1e-4 -0.17903157 -2.82030775 4580 0.558963
        5000 1e-4 -0.17750595 -2.82221670 22907 1.888204
        10000 1e-4 -0.17731527 -2.82245528 45816 3.891060
        1000 1e-5 -0.17902793 -2.82048083 7029 0.699758
        5000 1e-5 -0.17750506 -2.82238425 35156 2.899508
        10000 1e-5 -0.17731470 -2.82262218 70316 6.150663
        1000 1e-6 -0.17902253 -2.82050542 10890 1.099596
        5000 1e-6 -0.17750396 -2.82240051 54464 4.749011
        10000 1e-6 -0.17731415 -2.82263738 108931 9.135048
    """,
    PublishedTable(2, "5.1", "continuous", "DOPRI5(4)"): """
        1000 1e-4 -0.17980518 -2.82074422 865 0.256192
        5000 1e-4 -0.17766056 -2.82244931 4277 0.832777
        10000 1e-4 -0.17739246 -2.82266247 8543 1.395277
        1000 1e-5 -0.17981842 -2.82072801 874 0.259642
        5000 1e-5 -0.17766273 -2.82244646 4287 0.906540
        10000 1e-5 -0.17739351 -2.82266108 8553 1.365671
        1000 1e-6 -0.17982136 -2.82071778 892 0.274772
        5000 1e-6 -0.17766358 -2.82244421 4305 0.845633
        10000 1e-6 -0.17739399 -2.82265991 8570 1.458471
    """,
    PublishedTable(3, "5.1", "discrete", "ESDIRK34"): """
        1000 1e-4 -0.17902421 -2.82038368 10020 0.707572
        5000 1e-4 -0.17750535 -2.82227923 50113 2.565906
        10000 1e-4 -0.17731551 -2.82251616 100229 5.098090
        1000 1e-5 -0.17902248 -2.82049556 18245 1.032116
        5000 1e-5 -0.17750399 -2.82239049 91256 4.610991
        10000 1e-5 -0.17731418 -2.82262734 182520 9.095078
        1000 1e-6 -0.17902231 -2.82050608 32877 1.810772
        5000 1e-6 -0.17750394 -2.82240085 164448 8.193071
        10000 1e-6 -0.17731414 -2.82263770 328913 16.396372
    """,
    PublishedTable(4, "5.1", "discrete", "ESDIRK54b"): """
        1000 1e-4 -0.17902458 -2.81535892 2202 0.263587
        5000 1e-4 -0.17750439 -2.81724595 10955 0.982761
        10000 1e-4 -0.17731437 -2.81748183 21988 1.84532
        1000 1e-5 -0.17902306 -2.81948801 3177 0.493237
        5000 1e-5 -0.17750398 -2.82139569 15913 2.015899
        10000 1e-5 -0.17731416 -2.82163186 31819 3.922165
        1000 1e-6 -0.17902233 -2.82048569 6973 0.659497
        5000 1e-6 -0.17750394 -2.82238048 34857 2.800313
        10000 1e-6 -0.17731414 -2.82261734 69713 5.513546
    """,
    PublishedTable(5, "5.2", "discrete", "DOPRI5(4)"): """
        1000 1e-4 -0.17903161 -2.82059790 3985 0.943338
        5000 1e-4 -0.17750554 -2.82240853 19917 4.506534
        10000 1e-4 -0.17731478 -2.82274736 39833 9.271679
        1000 1e-5 -0.17902655 -2.82050775 6087 1.552909
        5000 1e-5 -0.17750475 -2.82240921 30421 6.987843
        10000 1e-5 -0.17731453 -2.82264689 60839 14.020309
        1000 1e-6 -0.17902252 -2.82050758 9374 2.272484
        5000 1e-6 -0.17750396 -2.82240265 46842 10.616184
        10000 1e-6 -0.17731415 -2.82263953 93678 21.575532
    """,
    PublishedTable(6, "5.2 fast", "discrete", "DOPRI5(4)"): """
        1000 1e-4 -0.17976496 -2.82127345 31043 10.012391
        5000 1e-4 -0.17824721 -2.82317224 155155 48.464997
        10000 1e-4 -0.17805749 -2.82340959 310295 98.683108
        1000 1e-5 -0.17911753 -2.82061094 47209 16.454477
        5000 1e-5 -0.17759861 -2.82250735 235948 86.814337
        10000 1e-5 -0.17740875 -2.82274440 471871 165.901471
        1000 1e-6 -0.17903376 -2.82052018 71619 25.547329
        5000 1e-6 -0.17751530 -2.82241518 357912 122.833276
        10000 1e-6 -0.17732549 -2.82265206 715778 251.898163
    """,
    PublishedTable(7, "5.2", "continuous", "DOPRI5(4)"): """
        1000 1e-4 -0.17937204 -2.82119132 2013 0.744567
        5000 1e-4 -0.17716789 -2.82294473 10032 3.195832
        10000 1e-4 -0.17689251 -2.82316380 20055 6.388512
        1000 1e-5 -0.17985206 -2.82070347 3135 1.237828
        5000 1e-5 -0.17765247 -2.82245862 15627 5.089826
        10000 1e-5 -0.17737755 -2.82267799 31242 10.198042
        1000 1e-6 -0.17986002 -2.82068455 4921 1.791315
        5000 1e-6 -0.17767114 -2.82243776 24537 7.992353
        10000 1e-6 -0.17739754 -2.82265691 49058 15.725143
    """,
    PublishedTable(8, "5.2 fast", "continuous", "DOPRI5(4)"): """
        1000 1e-4 -0.17926189 -2.82126759 29114 14.871598
        5000 1e-4 -0.17709000 -2.82301589 145501 73.598495
        10000 1e-4 -0.17681852 -2.82323442 290984 139.676315
        1000 1e-5 -0.17976240 -2.82076474 47571 23.700261
        5000 1e-5 -0.17758862 -2.82251680 237794 123.334587
        10000 1e-5 -0.17731691 -2.82273581 475572 228.881655
        1000 1e-6 -0.17982984 -2.82069480 75801 37.847378
        5000 1e-6 -0.17766016 -2.82244476 378931 180.256558
        10000 1e-6 -0.17738895 -2.82266351 757844 366.559093
    """,
    PublishedTable(9, "5.2", "discrete", "ESDIRK34"): """
        1000 1e-4 -0.17901947 -2.82067699 8565 1.639997
        5000 1e-4 -0.17750054 -2.82257306 42771 8.083445
        10000 1e-4 -0.17731068 -2.82281006 85528 16.039974
        1000 1e-5 -0.17902206 -2.82052288 15471 3.155167
        5000 1e-5 -0.17750359 -2.82241784 77267 14.694354
        10000 1e-5 -0.17731379 -2.82265469 154511 28.652010
        1000 1e-6 -0.17902232 -2.82050865 27759 5.586281
        5000 1e-6 -0.17750390 -2.82240349 138649 25.909193
        10000 1e-6 -0.17731410 -2.82264033 277261 51.264427
    """,
    PublishedTable(10, "5.2", "discrete", "ESDIRK54b"): """
        1000 1e-4 -0.17903531 -2.82113820 3143 1.201963
        5000 1e-4 -0.17751485 -2.82303791 15695 6.077862
        10000 1e-4 -0.17732486 -2.82327528 31384 11.717520
        1000 1e-5 -0.17902337 -2.82054659 5566 2.274696
        5000 1e-5 -0.17750471 -2.82244189 27802 10.467966
        10000 1e-5 -0.17731489 -2.82267878 55596 20.886199
        1000 1e-6 -0.17902250 -2.82051025 9297 3.633157
        5000 1e-6 -0.17750400 -2.82240518 46449 17.483210
        10000 1e-6 -0.17731420 -2.82264204 92890 34.767049
    """,
}


def _rows() -> tuple[PublishedRow, ...]:
    """The published rows, in the order of the paper."""
    rows = []
    for table, text in _TEXTS.items():
        for line in text.split("\n"):
            if line.strip():
                length, tolerance, first, second, steps, seconds = line.split()
                exponents = float(first), float(second)
                rows.append(PublishedRow(table, int(length), float(tolerance), exponents, int(steps), float(seconds)))
    return tuple(rows)


PUBLISHED = _rows()
TABLES = tuple(_TEXTS)


def limits() -> np.ndarray:
    """The exponents, (−3 ± √7)/2."""
    return np.array(_limits())


@functools.cache
def _limits() -> tuple[float, ...]:  # a report asks hundreds of times
    reference = zoo.spring_damper_dae().reference
    assert reference is not None
    return tuple(reference.exponents)


def exact(algorithm: str, length) -> np.ndarray:
    """λ_i + C_i/T (…, 2) as the algorithm defines them."""
    return limits() + np.array(OFFSETS[algorithm]) / np.asarray(length, float)[..., None]


def rows_of(lengths) -> tuple[PublishedRow, ...]:
    """The published rows of these lengths."""
    return tuple(row for row in PUBLISHED if row.length in lengths)
