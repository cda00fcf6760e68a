"""The checks of the reproduction of Fu, Wang & Wang, and the outcomes of the paper's claims."""

from typing import TYPE_CHECKING

import numpy as np

from ..._text import with_error
from ..claims import AGREED, CORRECTED, NOT_REPRODUCIBLE, Check, Claim
from . import cases, transfer_matrices

if TYPE_CHECKING:
    from . import reproduction as fu

__all__ = ["checks", "claims", "finite_error", "listed", "sign_of", "signed", "sum_of_the_scheme"]

FINITE_PART, FINITE_PART_ERROR = -0.17727, 1e-4  # of λ3 in Fig. 3: event-driven Taylor series, 3e6 periods
STICKS, STICKS_ERROR = 3.7e-4, 1.1e-5  # sticks per period, in Fig. 3
SLIPPING = 9.43421217 - 2.01777389218  # duration of the slip in a period, in Fig. 2
WITHIN, RATE_FACTOR = 5.0, 1.5  # in standard errors; factor for the rate of sticks
GATE = 5e-4  # standard error of λ1 in Fig. 3, at full length
COUPLING_ERROR = {True: 5e-3, False: 1e-2}  # error of λmax by synchronisation, on a cycle and in chaos (4 s.e.)
SIGNS = {"zero": 0, "positive": 1, "negative": -1}


def signed(text: str) -> str:
    """The text with typographic minus signs."""
    return text.replace("-inf", "−∞").replace("-", "−")


def sign_of(value: float) -> int:
    """The sign of an exponent; 0 below 1e-4."""
    return 0 if abs(value) < 1e-4 else int(np.sign(value))


def sum_of_the_scheme() -> float:
    """The sum of both exponents of Fig. 2 by the paper's RK4 scheme as Δt → 0: a stick keeps P₄(−1) instead of 0."""
    kept = 2 * np.log(transfer_matrices.fourth_order(-1.0))
    return float((kept - cases.CASES[1].beta * SLIPPING) / cases.PERIOD)


def checks(r: "fu.Reproduction") -> list[Check]:
    """All checks of the reproduction."""
    found = [one for cycle in r.found[:2] for one in _of_cycle(cycle)]
    found += _of_chaos(r.found[2], r.lengths.chaos)
    found += _of_scheme(r.found[1])
    found += [_of_synchronisation(one) for one in r.found]
    found += [_of_zero(r), *(_of_signs(one) for one in r.found), *_of_diagram(r.diagram)]
    return found + [_of_bifurcation(one) for one in r.vanishings]


def near(values, exact, tolerance: float) -> bool:
    """Whether both are −∞ at the same places, and equal within the tolerance elsewhere."""
    values, exact = np.asarray(values), np.asarray(exact)
    finite = np.isfinite(exact)
    same = bool(np.all(np.isneginf(values) == ~finite))
    return same and bool(np.max(np.abs(values[finite] - exact[finite])) < tolerance)


def listed(values, digits: int) -> str:
    """Formatted numbers."""
    # A zero has no sign.
    return ", ".join(
        signed("-inf" if np.isneginf(v) else f"{round(float(v), digits) + 0.0:.{digits}f}") for v in values
    )


def _of_cycle(found: "fu.FigureResults") -> list[Check]:
    from ... import zoo

    case, orbit, exact = found.case, found.orbit, np.array(found.exact.exponents)
    assert orbit is not None
    start = np.asarray(zoo.friction_pendulum(beta=case.beta, alpha=case.alpha).x0)
    multipliers, ours, point = (np.asarray(a) for a in (orbit.exponents, found.spectrum.exponents, orbit.x0))
    two, name = float(found.two.exponent), f"Fig. {case.figure}: "
    losses = case.losses or 0
    return [
        Check(name + "ln|μ|/T, to 1e-9", listed(exact, 9), listed(multipliers, 9), near(multipliers, exact, 1e-9)),
        Check(
            name + "(θ, θ') at t = 0, to 1e-9",
            listed(start, 9),
            listed(point, 9),
            bool(np.max(np.abs(point - start)) < 1e-9),
        ),
        Check(name + "spectrum, to 1e-4", listed(exact, 5), listed(ours, 5), near(ours, exact, 1e-4)),
        Check(name + "losses a period", f"{losses}", f"{found.losses:.4g}", abs(found.losses - losses) < 1e-3),
        Check(name + "two trajectories, to 1e-2", listed(exact[:1], 4), listed([two], 4), abs(two - exact[0]) < 1e-2),
    ]


def _of_chaos(found: "fu.FigureResults", periods: int) -> list[Check]:
    exact, s = found.exact, found.spectrum
    wanted, scatter = exact.exponents[0], exact.stderr[0]
    exponent, error = float(s.exponents[0]), float(s.stderr[0])
    two, two_error = float(found.two.exponent), float(found.two.stderr)
    finite, its_error = float(s.finite_exponents[1]), finite_error(s)
    expected, counted = STICKS * periods, found.losses * periods
    # With few expected losses their scatter exceeds the factor.
    rate = abs(counted - expected) <= WITHIN * expected**0.5
    rate = rate and (expected < 50 or 1 / RATE_FACTOR < counted / expected < RATE_FACTOR)
    gate = GATE * (_full_chaos() / periods) ** 0.5
    return [
        _within("Fig. 3: λ1, 5 standard errors", wanted, scatter, exponent, error),
        Check("Fig. 3: its standard error", f"at most {gate:.1e}", f"{error:.1e}", error <= gate),
        Check("Fig. 3: λ3", "−∞", listed([float(s.exponents[1])], 4), bool(np.isneginf(s.exponents[1]))),
        Check("Fig. 3: losses", f"{expected:.0f} ± {expected**0.5:.0f}", f"{counted:.0f}", bool(rate)),
        _within("Fig. 3: λ3 without losses, 5 errors", FINITE_PART, FINITE_PART_ERROR, finite, its_error),
        _within("Fig. 3: two trajectories, 5 errors", wanted, scatter, two, two_error),
    ]


def _full_chaos() -> int:
    return cases.FULL.chaos


def _within(name: str, wanted: float, scatter: float, found: float, error: float) -> Check:
    holds = abs(found - wanted) <= WITHIN * np.hypot(error, scatter)
    return Check(name, signed(with_error(wanted, scatter)), signed(with_error(found, error)), bool(holds))


def finite_error(s) -> float:
    """Standard error of the finite part of the last exponent, from the blocks; the exponent itself is −∞."""
    growth, ends = np.asarray(s.history.growth)[:, 1], np.asarray(s.history.time)
    rates = growth / np.diff(ends, prepend=0.0)
    return float(np.std(rates, ddof=1) / len(rates) ** 0.5)


def _of_scheme(found: "fu.FigureResults") -> list[Check]:
    euler, rk4 = found.schemes["euler"].exponents, found.schemes["rk4"].exponents
    total, wanted, off = rk4[1] + rk4[2], sum_of_the_scheme(), abs(euler[1] - found.exact.exponents[0])
    return [
        Check(
            "its RK4: λ2 + λ3 of Fig. 2, to 1e-3", listed([wanted], 4), listed([total], 4), abs(total - wanted) < 1e-3
        ),
        Check("its RK4: λ3 of Fig. 2", "finite, truth −∞", listed([rk4[2]], 4), bool(np.isfinite(rk4[2]))),
        Check("its Euler: λ2 of Fig. 2 is off", "1e-4 to 1e-2", f"{off:.1e}", 1e-4 < off < 1e-2),
    ]


def _of_synchronisation(found: "fu.FigureResults") -> Check:
    wanted, ours, gate = found.exact.exponents[0], found.synchronised, COUPLING_ERROR[found.case.cycle]
    name = f"Fig. {found.case.figure}: synchronisation, to {gate:.0e}"
    holds = abs(ours.exponent - wanted) < gate
    return Check(name, listed([wanted], 4), signed(f"{ours.exponent:.4f} ± {ours.error:.4f}"), holds)


def _of_zero(r: "fu.Reproduction") -> Check:
    zeros, gate = max(abs(found.zero) for found in r.found), 2 / (r.lengths.shown * cases.PERIOD)
    return Check("z = t adds an exponent 0", f"below {gate:.0e}", f"{zeros:.0e}", zeros < gate)


def _of_signs(found: "fu.FigureResults") -> Check:
    names = {number: name for name, number in SIGNS.items()}
    signs = [names[sign_of(value)] for value in found.exponents]
    says = ", ".join(found.case.says)
    return Check(
        f"Fig. {found.case.figure}: signs, as the paper has them", says, ", ".join(signs), says == ", ".join(signs)
    )


def _of_diagram(diagram) -> list[Check]:
    failed = int(np.sum(diagram.status != 0))
    rows = [Check("Fig. 4: runs that failed", "0", f"{failed}", failed == 0)]
    for beta, (label, exponent) in cases.SWEEP.items():
        row = int(np.argmin(np.abs(diagram.values - beta)))
        same = diagram.labels[row] == label
        found = diagram.exponents[row, same, 0]
        off = float(np.max(np.abs(found - exponent))) if len(found) else np.inf
        ours = listed([np.median(found)], 4) if len(found) else "not found"
        rows.append(Check(f"Fig. 4: λmax of {label} at β = {beta:g}, to 1e-3", listed([exponent], 4), ours, off < 1e-3))
    cycles, wrong = signs_on_cycles(diagram)
    rows.append(Check("Fig. 4: runs on cycles with λmax > 0", "0", f"{wrong} of {cycles}", wrong == 0))
    return rows


def signs_on_cycles(diagram) -> tuple[int, int]:
    """The number of runs that ended on a cycle by their points alone, and how many of them have λ₁ > 0."""
    cycles = np.array([[label.startswith("P") for label in row] for row in diagram.labels])
    positive = diagram.exponents[..., 0] > WITHIN * diagram.stderr[..., 0]
    return int(cycles.sum()), int((cycles & positive).sum())


def _of_bifurcation(one) -> Check:
    listed = one.listed
    name = f"λ1 = 0: {listed.name}, β to {listed.error:.0e}"
    return Check(name, f"{listed.beta:.10g}", f"{one.zero:.10f}", one.agrees)


def claims(r: "fu.Reproduction") -> list[Claim]:
    """The claims of the paper, item by item, with outcome and evidence."""
    return [*_about_the_method(r.found[1]), *_about_the_motions(r), *_about_the_diagram(r)]


def _about_the_method(two: "fu.FigureResults") -> list[Claim]:
    rk4, limit = two.schemes["rk4"].exponents, sum_of_the_scheme()
    return [
        Claim(
            "Eqs. (5) to (10)",
            "an Euler step with the transfer matrix is the cocycle at the discontinuity",
            "it is S = I + Jac after an Euler step of the old field, to rounding",
            AGREED,
        ),
        Claim(
            "Eqs. (7), (11), (13)",
            "as printed",
            "(7) lacks factors u, (11) a logarithm, and f₄ of (13) has the wrong sign and is no mode of the motion",
            CORRECTED,
            "eq. (7) does not follow from (6), nor (11) from the growth of the norms, and with f₄ as printed a motion "
            "that comes to rest is pushed the wrong way",
        ),
        Claim(
            "Remark 2",
            "the transfer matrix may be used in RK4, which makes the result more precise",
            f"RK4 keeps P₄(−1) = 0.375 of what a stick destroys, at any step: λ3 of Fig. 2 is {listed([rk4[2]], 3)}",
            CORRECTED,
            f"by that formula λ2 + λ3 goes to {listed([limit], 4)} as Δt → 0, and {listed([rk4[1] + rk4[2]], 4)} is "
            f"found; λ2 = {listed([rk4[1]], 4)} is wrong too",
        ),
        Claim(
            "§1 and §4",
            "more precise and faster than the method of Lamarque & Bastien",
            "with Euler's method both are the same computation",
            NOT_REPRODUCIBLE,
            "the paper tells no step, length, start or computing time, and shows curves without numbers",
        ),
    ]


def _about_the_motions(r: "fu.Reproduction") -> list[Claim]:
    one, two, three = r.found
    assert two.orbit is not None
    multipliers = ", ".join(f"{float(m.real):.6g}" for m in np.asarray(two.orbit.multipliers))
    return [
        Claim(
            "§1, synchronisation",
            "the estimate by synchronisation of reference [5] tells chaos from periodic motion, but not bifurcations",
            "it has the sign of λmax in all three figures, but tells it only to some "
            f"{COUPLING_ERROR[True]:.0e} on cycles and {COUPLING_ERROR[False]:.0e} in chaos",
            *_by(all(np.sign(each.synchronised.exponent) == np.sign(each.exact.exponents[0]) for each in r.found)),
        ),
        Claim(
            "Fig. 1",
            "a slip-slip cycle, one exponent zero and two negative",
            listed(one.exponents, 4),
            *_by(_of_signs(one).holds),
        ),
        Claim(
            "Fig. 2",
            "a stick-slip cycle, one exponent zero and two negative, each of them a finite curve",
            listed(two.exponents, 4),
            CORRECTED,
            f"the signs agree, but λ3 is not finite: the cycle has the multipliers {multipliers}, and "
            f"{two.losses:.3g} directions are lost a period",
        ),
        Claim(
            "Fig. 3",
            "chaos, exponents positive, zero and negative",
            listed(three.exponents, 4),
            CORRECTED,
            "the signs agree, but the motion sticks 3.7e−4 times a period, so that λ3 is −∞ in the long run; a run of "
            f"a few hundred periods that has not stuck yet says {listed([FINITE_PART], 3)}",
        ),
    ]


def _about_the_diagram(r: "fu.Reproduction") -> list[Claim]:
    vanish, (cycles, wrong) = sum(v.agrees for v in r.vanishings), signs_on_cycles(r.diagram)
    chaos, slow = (int(np.sum(r.diagram.labels == name)) for name in ("chaos", "aperiodic/slow"))
    return [
        Claim(
            "Fig. 4, signs",
            "λmax is positive in chaos and negative on cycles",
            f"{wrong} of {cycles} runs on cycles have λmax > 0; of the others {chaos} have λmax > 0 by 5 standard "
            f"errors, and {slow} are undecided (weak chaos, or still settling)",
            *_by(wrong == 0),
        ),
        Claim(
            "Fig. 4, bifurcations",
            "λmax = 0 where the attractor bifurcates",
            f"so it is at {vanish} of {len(r.vanishings)} bifurcations of cycles",
            *_by(vanish == len(r.vanishings)),
        ),
        Claim(
            "Fig. 4, attractors",
            "what the motion ends on, for each β",
            "several attractors stand side by side for some β, and near β = 0 chaos is transient, see above",
            NOT_REPRODUCIBLE,
            "which of them is shown depends on the starts and lengths of the runs, which the paper does not tell",
        ),
    ]


def _by(holds: bool) -> tuple[str, str]:
    """The outcome of a claim that depends on a check."""
    return (AGREED, "") if holds else (CORRECTED, "the check above fails")
