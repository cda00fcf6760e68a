"""Checks, claims, printed lines and numbers of the extensions of Linh, Truong & Tuyen."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...claims import AGREED, Check, Claim
from ...output import plain
from ..checks import at_most, listed, ranged
from ..tables import EXAMPLES, OF_TABLES, SHORTEST_LENGTH, exact, limits
from .extensions import OF_IMPLICIT, Extensions

__all__ = ["checks", "claims", "lines", "numbers"]

LARGEST_ERROR = 10  # largest error of exponents, in tolerances
SVD_AGREES, SUM_AGREES = (
    1e-7,
    1e-6,
)  # differences of SVD exponents between both examples, and of their sum from that by QR
ERROR_OVER_ESTIMATE = 1.05  # largest error of the SVD method over its own estimate
SIZE = 50  # largest bound of §4.1, in tolerances
OF_EQUATIONS, OF_GRID = 1e-7, 1e-6


def _in_tolerances(errors) -> np.ndarray:
    """The larger error for each tolerance (3,)."""
    return np.max(errors, axis=1) / np.array(OF_TABLES)


def _apart(e: Extensions) -> float:
    """Difference of the SVD method's exponents between the examples."""
    first, second = (found[0] for found in e.svd.values())
    return float(np.max(np.abs(first - second)))


def _off_in_sum(e: Extensions) -> float:
    """Difference of the sums of exponents: both methods give the same volumes."""
    wanted = np.sum(exact("continuous", SHORTEST_LENGTH))
    return max(abs(float(np.sum(found[0]) - wanted)) for found in e.svd.values())


def _off_in_limit(e: Extensions) -> list:
    """|λ(T) − λ| over the SVD method's estimate of it."""
    return [np.abs(found[0] - limits()) / found[1] for found in e.svd.values()]


def _shares(e: Extensions) -> list:
    """The errors over their bounds."""
    return [found[:, 0] / found[:, 1] for found in e.bounds.values()]


def _sizes(e: Extensions) -> list:
    """The larger bound over the tolerance."""
    return [_in_tolerances(found[:, 1]) for found in e.bounds.values()]


def _off_at_implicit(e: Extensions) -> np.ndarray:
    return np.abs(e.implicit - [*limits(), OF_IMPLICIT])


def _off_on_grid(e: Extensions) -> float:
    return float(np.max(np.abs(e.large.found - e.large.exact)))


def checks(e: Extensions) -> Iterator[Check]:
    """All checks."""
    for name, runs in (("Radau IIA", e.collocation), ("continuous, ESDIRK54b", e.continuous_esdirk)):
        for example, errors in runs.items():
            yield at_most(
                f"{EXAMPLES[example]}, {name}: errors over the tolerance", _in_tolerances(errors), LARGEST_ERROR
            )
    yield at_most("SVD method: |λ(T) − λ| over what it says", _off_in_limit(e), ERROR_OVER_ESTIMATE)
    yield at_most("SVD method: its exponents have the sum of those by QR", _off_in_sum(e), SUM_AGREES)
    yield at_most("SVD method: Examples 5.1 and 5.2 have the same singular values", _apart(e), SVD_AGREES)
    yield at_most("§4.1: errors over their bounds, at rest", _shares(e), 1)
    yield at_most("§4.1: bounds over the tolerance", _sizes(e), SIZE)
    yield at_most("F(t, x, x') = 0: exponents less the exact ones", _off_at_implicit(e), OF_EQUATIONS)
    yield at_most(f"a power grid of {e.large.n} components: exponents less the exact ones", _off_on_grid(e), OF_GRID)


def claims(e: Extensions) -> list[Claim]:
    """Claims of the paper on what it does not compute."""
    of_radau, of_continuous = (
        ranged([_in_tolerances(errors) for errors in runs.values()], ".1g")
        for runs in (e.collocation, e.continuous_esdirk)
    )
    return [
        Claim(
            "§2.2",
            "implicit Runge–Kutta methods solve (9) in a similar way",
            f"Radau IIA: errors of {of_radau} tolerances, both examples; its order is among those of §4.1",
            AGREED,
        ),
        Claim(
            "§5",
            "ESDIRK methods within the continuous algorithm lead to nonlinear matrix equations",
            f"they are solved by Newton's method; by ESDIRK54b errors of {of_continuous} tolerances",
            AGREED,
        ),
        Claim(
            "§1 and [18]",
            "earlier works compute spectra by singular values as well as by QR",
            f"exponents by singular values are as near to the limits as they say, {listed(e.svd['5.1'][1], '.1e')}; "
            f"their sum is that by QR to {_off_in_sum(e):.0e}",
            AGREED,
        ),
        Claim(
            "§4.1",
            "under integral separation a bound of the errors can be computed, of the size of the local errors",
            f"bounds of {ranged(_sizes(e), '.0f')} tolerances (at rest), of which the errors are at most "
            f"{100 * np.max(_shares(e)):.0f} %",
            AGREED,
        ),
        Claim(
            "§1 and §6",
            "the methods extend to fully implicit and to general nonlinear equations of index one",
            f"to F(t, x, x') = 0: Example 5.1, its rows mixed, and an equation that is not linear in x', within "
            f"{np.max(_off_at_implicit(e)):.0e}",
            AGREED,
        ),
        Claim(
            "§6",
            "large problems from applications remain to be tested",
            f"one that resembles them, a power grid of {e.large.n} components: all {e.large.d} exponents over a short "
            f"time are within {_off_on_grid(e):.0e} of those by sparse matrices of SciPy's",
            AGREED,
        ),
    ]


def lines(e: Extensions) -> Iterator[str]:
    """Lines that are printed after the tables."""
    tolerances = ", ".join(f"{tol:.0e}".replace("e-0", "e-") for tol in OF_TABLES)
    length = f"{SHORTEST_LENGTH:g}"
    yield f"What the paper names and does not compute. |λ − exact| at T = {length}, TOL = {tolerances}, λ1; λ2:"
    for name, runs in (("Radau IIA for (9)", e.collocation), ("continuous QR, ESDIRK54b", e.continuous_esdirk)):
        for example, errors in runs.items():
            yield f"  {EXAMPLES[example]}, {name}: {'; '.join(listed(column, '.1e') for column in errors.T)}"
    yield f"Exponents by the SVD method at T = {length}; those by QR; how far the former may be from the limits:"
    for example, (found, error) in e.svd.items():
        by_qr = listed(exact("continuous", SHORTEST_LENGTH), ".8f")
        yield f"  {EXAMPLES[example]}: {listed(found, '.8f')}; {by_qr}; {listed(error, '.6f')}"
    yield "The bound of §4.1 at rest, |λ − exact| ≤ bound, λ1; λ2:"
    for example, found in e.bounds.items():
        for tolerance, (errors, bounds) in zip(tolerances.split(", "), found, strict=True):
            parts = (" ≤ ".join(listed(one, ".1e") for one in pair) for pair in zip(errors, bounds, strict=True))
            yield f"  {EXAMPLES[example]}, {tolerance}: {'; '.join(parts)}"
    yield "F(t, x, x') = 0, exponents and exact ones: Example 5.1, its rows mixed; x' + x'³/10 + x + y = g(t), y = x²"
    yield f"  {listed(e.implicit[:2], '.9f')}; {listed(e.implicit[2], '.9f')}"
    yield f"  {listed(limits(), '.9f')}; {listed(OF_IMPLICIT, '.9f')}"
    yield f"A power grid of {e.large.n} components and {e.large.n - e.large.d} constraints, banded, from rest:"
    ends = "; ".join(listed(values[[0, -1]], ".9f") for values in (e.large.found, e.large.exact))
    yield f"  first and last exponent, and exact ones: {ends}; all {e.large.d} within {_off_on_grid(e):.1e}"


def numbers(e: Extensions) -> dict[str, Any]:
    """All numbers, ready for JSON."""
    return {
        "radau": {example: plain(errors) for example, errors in e.collocation.items()},
        "continuous_esdirk54b": {example: plain(errors) for example, errors in e.continuous_esdirk.items()},
        "svd": {example: {"exponents": plain(found[0]), "error": plain(found[1])} for example, found in e.svd.items()},
        "bounds": {
            example: {"errors": plain(found[:, 0]), "bounds": plain(found[:, 1])} for example, found in e.bounds.items()
        },
        "implicit": {"exponents": plain(e.implicit), "exact": plain(np.array([*limits(), OF_IMPLICIT]))},
        "large": {"n": e.large.n, "exponents": plain(e.large.found), "exact": plain(e.large.exact)},
    }
