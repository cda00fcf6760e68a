"""What Linh, Truong & Tuyen name but do not compute: other methods on their examples, and other equations.

Collocation for (9), ESDIRK methods within the continuous algorithm, the SVD method of their reference [18], the bound
of §4.1, fully implicit equations (§1 and §6), and a large system (§6).
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import scipy.linalg

from ....analysis.indicators.exponent_bounds import exponent_bounds
from ....analysis.indicators.svd_spectra import svd_spectrum
from ....analysis.spectra import lyapunov_spectrum
from ....integrators import ESDIRK, ContinuousQR, HalfExplicit, RadauIIA
from ....integrators.base import Method
from ....systems.consistency import consistent_start
from ....systems.implicit_daes import implicit_dae
from ..tables import OF_TABLES, SHORTEST_LENGTH, exact, limits, problem_of
from .power_grids import Grid

__all__ = [
    "BOTH", "OF_IMPLICIT", "Extensions", "Large", "bounds", "collocation", "continuous_esdirk", "implicit", "large",
    "svd",
]  # fmt: skip

BOTH = ("5.1", "5.2")
TIME_AT_REST, TIME_COUNTED = 50.0, 100.0  # lengths of runs at rest; directions have converged to e^(−2.6 · 50)
RTOL_OF_EXTENSIONS = 1e-9
TIME_OF_LARGE_SYSTEM = 6.0  # length for the large system, whose forty growths differ by e^4
# Ẋ + 0.1 ẋ³ = … along x = sin t, y = x²: variations grow like exp ∫ −(1 + 2 sin t) / (1 + 0.3 cos² t).
OF_IMPLICIT = -1 / np.sqrt(1.3)


@dataclasses.dataclass(frozen=True)
class Large:
    """All exponents of a power grid at rest, over a short time.

    Attributes:
        n: components; d: exponents.
        found: (d,) ln σ_i / T by the SVD method; exact: (d,) by SciPy's sparse LU factors and a matrix exponential.
    """

    n: int
    d: int
    found: np.ndarray
    exact: np.ndarray


@dataclasses.dataclass(frozen=True)
class Extensions:
    """Results beyond those of the paper.

    Attributes:
        collocation: for each of `BOTH` |λ − exact| (3, 2) at T = 1000 by Radau IIA, for the tolerances of the tables.
        continuous_esdirk: the same by continuous QR in the stages of ESDIRK54b.
        svd: for each of `BOTH` λ (2,) at T = 1000 by singular values, TOL = 1e-9, and its estimated distances from
            the limits (2,): (2, 2).
        bounds: for each of `BOTH`, at rest, |λ − exact| and the bounds of §4.1 (3, 2, 2), by tolerance.
        implicit: λ (2,) of Example 5.1 as F(t, x, x') = 0, and λ of an equation that is not linear in x': (3,).
        large: a power grid.
    """

    collocation: dict[str, np.ndarray]
    continuous_esdirk: dict[str, np.ndarray]
    svd: dict[str, np.ndarray]
    bounds: dict[str, np.ndarray]
    implicit: np.ndarray
    large: Large


def _errors(example: str, methods: list[Method]) -> np.ndarray:
    system, x0, args = problem_of(example)
    runs = [
        lyapunov_spectrum(system, x0, args, t1=SHORTEST_LENGTH, method=method, blocks=2).exponents for method in methods
    ]
    return np.abs(np.stack(runs) - exact("continuous", SHORTEST_LENGTH))  # ln R(t₀) is not counted


def collocation(example: str) -> np.ndarray:
    """As in `Extensions`."""
    return _errors(example, [RadauIIA(tolerance, atol=tolerance) for tolerance in OF_TABLES])


def continuous_esdirk(example: str) -> np.ndarray:
    """As in `Extensions`."""
    return _errors(
        example, [ContinuousQR(ESDIRK("esdirk54b", rtol=tolerance, atol=tolerance)) for tolerance in OF_TABLES]
    )


def svd(example: str) -> np.ndarray:
    """As in `Extensions`."""
    system, x0, args = problem_of(example)
    found = svd_spectrum(
        system,
        x0,
        args,
        t1=SHORTEST_LENGTH,
        blocks=16,
        method=HalfExplicit(RTOL_OF_EXTENSIONS, atol=RTOL_OF_EXTENSIONS),
    )
    return np.stack([found.exponents, found.error])


def bounds(example: str) -> np.ndarray:
    """At rest the equations are linear, as the bound assumes, and converged directions grow at the limits."""
    system, x0, args = problem_of(example)
    found = []
    for tolerance in OF_TABLES:
        one = exponent_bounds(
            system,
            jnp.zeros_like(x0),
            args,
            t1=TIME_COUNTED,
            transient=TIME_AT_REST,
            method=HalfExplicit(tolerance, atol=tolerance),
        )
        found.append([np.abs(one.exponents - limits()), one.bound])
    return np.array(found)


def implicit() -> np.ndarray:
    """Example 5.1 with mixed rows, and a system with a known exponent that has no form E(t) x' = f."""
    system, x0, args = problem_of("5.1")
    mixing = jnp.asarray(scipy.linalg.hadamard(4) / 2)

    def mixed(t, x, dx, args):
        return mixing @ (system.field.leading(t, args) @ dx - system.field.residual(t, x, args))

    def forced(t, x, dx, args):
        c, s = jnp.cos(t), jnp.sin(t)
        return jnp.stack([dx[0] + 0.1 * dx[0] ** 3 + x[0] + x[1] - (c + 0.1 * c**3 + s + s**2), x[1] - x[0] ** 2])

    def exponents(dae, guess, args, transient, t1):
        start = consistent_start(dae, guess, args)
        return lyapunov_spectrum(
            dae,
            start,
            args,
            t1=t1,
            transient=transient,
            method=HalfExplicit(RTOL_OF_EXTENSIONS, atol=RTOL_OF_EXTENSIONS),
            blocks=2,
        ).exponents

    first = exponents(implicit_dae(mixed, x0, args), x0, args, 3 * TIME_AT_REST, TIME_AT_REST)
    curved = implicit_dae(forced, [0.0, 0.0], slope=[1.0, 0.0])
    return np.concatenate([first, exponents(curved, [0.0, 0.0, 1.0], None, 2 * np.pi, 20 * np.pi)])


def large(length: int = 60) -> Large:
    """A grid of three buses by `length`; constraints are solved as banded ones."""
    grid = Grid(length)
    dae = grid.dae(3)
    start = consistent_start(dae, grid.rest)
    found = svd_spectrum(dae, start, t1=TIME_OF_LARGE_SYSTEM, blocks=2, method=HalfExplicit(1e-8, atol=1e-8))
    return Large(grid.n, grid.d, found.exponents, grid.log_growth(TIME_OF_LARGE_SYSTEM) / TIME_OF_LARGE_SYSTEM)
