"""The table and the numbers of the reproduction of Fu, Wang & Wang."""

import dataclasses
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._text import with_error
from ..claims import check_lines, claim_lines
from ..output import plain
from . import cases, transfer_matrices
from .checks import FINITE_PART, FINITE_PART_ERROR, STICKS, STICKS_ERROR, finite_error, signed, sum_of_the_scheme

if TYPE_CHECKING:
    from . import reproduction as fu

__all__ = ["OUTCOMES", "numbers", "outcomes", "table"]

HEADS = ("paper", "exact", "ours", "its scheme, Euler", "its scheme, RK4", "two trajectories", "synchronisation")
WIDTHS = (9, 15, 18, 18, 15, 17, 16)
DIGITS = 6
LATE_PERIODS = 100  # periods: usually more than convergence to a cycle takes


def _of_cycle(value: float) -> str:
    return signed("-inf" if np.isneginf(value) else f"{value:.6f}")


def _rows(found: "fu.FigureResults") -> list[list[str]]:
    """λ1 ≥ λ2 ≥ λ3 of (θ, θ', z)."""
    exact, s, two, coupling = found.exact, found.spectrum, found.two, found.synchronised
    schemes = []
    for run in found.schemes.values():
        order = np.argsort(np.abs(run.exponents))
        # The smallest in modulus belongs to z = t, which is not coupled to the others.
        rest = [i for i in range(3) if i != order[0]]
        errors = run.stderr if not found.case.cycle else np.zeros(3)
        schemes.append([_zero(float(run.exponents[order[0]]))] + [_scheme(run.exponents[i], errors[i]) for i in rest])
    ours = [
        _of_cycle(float(value)) if found.case.cycle else signed(with_error(float(value), float(error)))
        for value, error in zip(s.exponents, s.stderr, strict=True)
    ]
    values = [_number(v, e, found.case.cycle) for v, e in zip(exact.exponents, exact.stderr, strict=True)]
    apart = signed(with_error(float(two.exponent), float(two.stderr)))
    columns = [
        ["0", *values],
        [_zero(found.zero), *ours],
        schemes[0],
        schemes[1],
        ["", apart if not found.case.cycle else _of_cycle(float(two.exponent)), ""],
        ["", signed(f"{coupling.exponent:.4f} ± {coupling.error:.4f}"), ""],
    ]
    return [[found.case.says[row], *(column[i] for column in columns)] for row, i in enumerate(found.order)]


def _zero(value: float) -> str:
    return "0" if abs(value) < 1e-12 else signed(f"{value:.0e}")


def _scheme(value: float, error: float) -> str:
    return signed(with_error(value, error) if error > 0 else f"{value:.5f}")


def _number(value: float, error: float, cycle: bool) -> str:
    if np.isneginf(value):
        return "−∞"
    return signed(f"{value:.12f}" if cycle else with_error(value, error))


def table(r: "fu.Reproduction") -> str:
    """The result as a table."""
    lines = [
        "Fu, Wang & Wang: θ'' + βθ' + 0.87 sin θ + α Sgn(θ') ∋ 0.586 sin 0.666 t, exponents per unit of time",
        "λ1 ≥ λ2 ≥ λ3 of (θ, θ', z) with z = t, which adds the 0; the paper tells signs only; in brackets one standard "
        "error",
        "",
        "        " + " ".join(f"{head:>{width}s}" for head, width in zip(HEADS, WIDTHS, strict=True)),
    ]
    for found in r.found:
        lines += [
            "",
            f"Fig. {found.case.figure}  β = {found.case.beta:g}, α = {found.case.alpha:g}: {found.case.motion}",
        ]
        for name, row in zip(("λ1", "λ2", "λ3"), _rows(found), strict=True):
            lines.append(f"  {name:<6s}" + " ".join(f"{cell:>{w}s}" for cell, w in zip(row, WIDTHS, strict=True)))
        lines += _remarks(found)
    lines += ["", *_about_the_scheme(r), "", *_about_the_diagram(r.diagram)]
    lines += ["", *check_lines(r.checks), "", *claim_lines(r.claims)]
    failed = [one.name for one in r.checks if not one.holds]
    verdict = f"FAILED: {'; '.join(failed)}" if failed else f"passed: all {len(r.checks)} checks hold"
    return "\n".join([*(line.rstrip() for line in lines), "", verdict, f"(one period is 2π/ω = {cases.PERIOD:.6f})"])


def _remarks(found: "fu.FigureResults") -> list[str]:
    s, orbit = found.spectrum, found.orbit
    periods = float(np.mean(np.asarray(s.time))) / cases.PERIOD
    if orbit is not None:
        values = ", ".join(_number(float(v), 0.0, True) for v in orbit.exponents)
        point = ", ".join(f"{float(v):.12f}" for v in orbit.x0)
        return [
            f"  multipliers of the cycle: λ = {values}; at t = 0 (θ, θ') = ({signed(point)})",
            f"  {found.losses:.4g} directions lost a period, in {periods:.0f} periods",
        ]
    counted, finite = found.losses * periods, float(s.finite_exponents[1])
    rate, error = found.losses, found.losses / max(counted, 1.0) ** 0.5
    return [
        f"  λ3 without the moments of loss {signed(with_error(finite, finite_error(s)))}, reference "
        f"{signed(with_error(FINITE_PART, FINITE_PART_ERROR))}; {counted:.0f} directions lost in {periods:.0f} "
        "periods,",
        f"  {rate:.2e} ± {error:.1e} a period, reference {STICKS:.2e} ± {STICKS_ERROR:.1e}".replace("e-0", "e−"),
    ]


def _about_the_scheme(r: "fu.Reproduction") -> list[str]:
    rk4 = r.found[1].schemes["rk4"].exponents
    kept = transfer_matrices.fourth_order(-1.0)
    return textwrap.wrap(
        f"The paper's scheme, {cases.STEPS_PER_PERIOD} steps a period. RK4 keeps P₄(−1) = {kept:g} of what a stick "
        f"destroys, at any step: in Fig. 2 the two exponents then have the sum {signed(f'{sum_of_the_scheme():.5f}')} "
        f"as Δt → 0, here {signed(f'{rk4[1] + rk4[2]:.5f}')}; the truth is −∞. Euler destroys it; its λ3 is the "
        "rounding that Gram–Schmidt finds in the third vector, and its λ2 is off by its step.",
        118,
    )


def _about_the_diagram(diagram) -> list[str]:
    kinds = np.array(outcomes(diagram))
    found = {kind: _ranges([float(v) for v in diagram.values[kinds == kind]], diagram) for kind in OUTCOMES}
    return textwrap.wrap(
        f"Fig. 4: {len(diagram.values)} values of β in [0, 0.3], {len(diagram.kinds)} runs each. "
        + " ".join(f"{OUTCOMES[kind].capitalize()}: β = {where}." for kind, where in found.items()),
        118,
    )


OUTCOMES = {
    "coexisting": "several cycles",
    "beside chaos": "cycles in some runs, chaos in others",
    "undecided": "cycles in some runs, others that are neither settled nor clearly chaotic",
    "transient": f"cycles and chaos, and runs left chaos for a cycle after more than {LATE_PERIODS} periods",
}


def outcomes(diagram) -> list[str]:
    """For each value "one", or one of `OUTCOMES`."""
    return [_outcome(row, lifetimes) for row, lifetimes in zip(diagram.labels, diagram.lifetimes, strict=True)]


def _outcome(row, lifetimes) -> str:
    periodic = np.array([label.startswith("P") for label in row])
    if "chaos" in row and np.any(periodic):
        return "transient" if np.any(lifetimes[periodic] > LATE_PERIODS) else "beside chaos"
    if len(set(row[periodic])) > 1:
        return "coexisting"
    return "undecided" if "aperiodic/slow" in row and np.any(periodic) else "one"


def _ranges(values, diagram) -> str:
    """Values as "0.1, 0.14–0.16", neighbours of the grid joined."""
    step, groups = 1.5 * (diagram.values[1] - diagram.values[0]), []
    for value in values:
        if groups and value - groups[-1][-1] < step:
            groups[-1].append(value)
        else:
            groups.append([value])
    names = [f"{g[0]:g}" if len(g) == 1 else f"{g[0]:g}–{g[-1]:g}" for g in groups]
    return ", ".join(names) or "none"


def numbers(r: "fu.Reproduction") -> dict[str, Any]:
    """All numbers, ready for JSON: −∞ is "-inf", nan is null."""
    return {
        "paper": "Fu Shihui, Wang Qi & Wang Shimin, Numerical calculation of Lyapunov exponents of discontinuous "
        "systems with dry friction, Journal of Dynamics and Control 2 (2004)",
        "period": cases.PERIOD,
        "figures": [_figure(found) for found in r.found],
        "scheme": {
            "steps_a_period": cases.STEPS_PER_PERIOD,
            "sum_in_fig_2": float(np.sum(r.found[1].schemes["rk4"].exponents[1:])),
            "predicted": sum_of_the_scheme(),
        },
        "fig_4": _diagram(r.diagram),
        "bifurcations": [_bifurcation(one) for one in r.vanishings],
        "checks": {one.name: bool(one.holds) for one in r.checks},
        "claims": [dataclasses.asdict(one) for one in r.claims],
        "passed": bool(r.passed),
    }


def _bifurcation(one) -> dict[str, Any]:
    return {
        "beta": one.listed.beta,
        "what": one.listed.name,
        "zero_of_exponent": one.zero,
        "distance": one.listed.near,
        "exponent": one.stable[0],
        "exponent_beyond": plain(one.beyond),
    }


def _figure(found: "fu.FigureResults") -> dict[str, Any]:

    case, s, exact, orbit = found.case, found.spectrum, found.exact, found.orbit
    return {
        "figure": case.figure,
        "beta": case.beta,
        "alpha": case.alpha,
        "paper": list(case.says),
        "exponents": plain(found.exponents),
        "exact": {"exponents": plain(exact.exponents), "stderr": plain(exact.stderr), "source": exact.source},
        "ours": {
            "time": float(np.mean(np.asarray(s.time))),
            "status": str(s.status),
            "exponents": plain(s.exponents),
            "stderr": plain(s.stderr),
            "finite_exponents": plain(s.finite_exponents),
            "losses_a_period": found.losses,
        },
        "three_exponents": {
            "exponents": plain(found.autonomous.exponents),
            "time": plain(found.autonomous.history.time),
            "running": plain(found.autonomous.history.exponents),
        },
        "cycle": None
        if orbit is None
        else {
            "x0": plain(orbit.x0),
            "multipliers": [[float(m.real), float(m.imag)] for m in np.asarray(orbit.multipliers)],
            "exponents": plain(orbit.exponents),
        },
        "two_trajectories": {"exponent": float(found.two.exponent), "stderr": float(found.two.stderr)},
        "synchronisation": {
            "exponent": found.synchronised.exponent,
            "error": found.synchronised.error,
            "trials": found.synchronised.trials,
            "couplings": plain(found.synchronised.couplings),
            "followed": plain(found.synchronised.followed),
        },
        "scheme": {
            name: {"exponents": plain(run.exponents), "stderr": plain(run.stderr), "periods": len(run.growth)}
            for name, run in found.schemes.items()
        },
        "poincare": plain(np.round(np.asarray(found.section.x), DIGITS)),
    }


def _diagram(diagram) -> dict[str, Any]:
    lifetimes, errors = diagram.mean_lifetimes()
    return {
        "beta": plain(diagram.values),
        "kinds": list(diagram.kinds),
        "labels": diagram.labels.tolist(),
        "outcomes": outcomes(diagram),
        "exponents": plain(diagram.exponents),
        "stderr": plain(diagram.stderr),
        "finite_exponents": plain(diagram.finite_exponents),
        "losses": plain(diagram.losses),
        "mean_lifetimes": {"periods": plain(lifetimes), "stderr": plain(errors)},
        "theta": plain(np.round(diagram.points[..., 0], DIGITS - 1)),
    }
