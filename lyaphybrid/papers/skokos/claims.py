"""The claims of Skokos & Gerlach, item by item, with their outcomes; the witness is a program that shares no code.

Our text of the paper has the mantissas of its numbers, but not the powers of ten.
"""

from typing import TYPE_CHECKING

import numpy as np

from ..claims import AGREED, CORRECTED, NOT_REPRODUCIBLE, Claim
from .cases import METHODS, ORBITS, TABLE, TRUSTED_METHODS
from .checks import DECADES, early, growth_of_energy, law, level, paired, slopes
from .witness import SYMPLECTIC, WITNESS, constant, listed, witnessed

if TYPE_CHECKING:
    from . import reproduction as skokos

__all__ = ["claims"]

FALLEN_GALI2 = -4.0  # log10 GALI_2 of R3 below which it is not constant, as it must be on the torus


def claims(r: "skokos.Reproduction") -> list[Claim]:
    """The claims of the paper, item by item, with outcome and evidence."""
    parts = (_about_energy, _about_r1, _about_c1, _about_c2, _about_more_freedoms, _about_times)
    return [one for part in parts for one in part(r)]


def _sums(r: "skokos.Reproduction", orbit: str) -> str:
    return f"t |λi + λ2N+1−i| is {max(paired(run) for run in r.of(orbit).values()):.2g} at most, by every method"


def _about_energy(r: "skokos.Reproduction") -> list[Claim]:
    drifts = growth_of_energy(r.of_r1("DOP853", 0.2))
    stand = [growth_of_energy(r.of_r1("TM", step)) for step in (0.05, 0.1, 0.2, 0.5)]
    errors = {step: (r.of_r1("DOP853", step).energy, r.of_r1("TM", step).energy) for step in (0.05, 0.1, 0.2, 0.5)}
    per_step = ", ".join(f"{dop:.0e} and {tm:.0e} at τ = {step:g}" for step, (dop, tm) in errors.items())
    return [
        Claim(
            "Fig. 1",
            "R1 lies on five islands of the section, C1 is scattered",
            "the same",
            AGREED,
        ),
        Claim(
            "§VII.1.1, energy (skokos-12)",
            "its error grows with time by DOP853, and fluctuates round a constant by the other methods",
            f"it goes as t^{drifts:.2f} by DOP853 at τ = 0.2, as t^{listed([min(stand)], '.2f')} to "
            f"t^{listed([max(stand)], '.2f')} by TM; TDHcc and TDHes have the orbit of TM",
            AGREED,
        ),
        Claim(
            "Table 1, energy",
            "that of DOP853 is smaller at τ = 0.05, and no longer so at large steps",
            f"DOP853 (δ = 1e-5) and TM at t = {r.lengths.table:.0e}: {per_step}; what drifts goes on growing",
            AGREED,
        ),
        Claim(
            "Table 1, energy",
            "its values at t = 1e8",
            "they stand in the table, at another time",
            NOT_REPRODUCIBLE,
            "the powers of ten and the values of δ are lost from the text",
        ),
    ]


def _about_r1(r: "skokos.Reproduction") -> list[Claim]:
    # Long: a list of claims, one after the other.
    t = r.lengths.table
    levels = {method: level(r.of_r1(method)) for method in ("TDHcc", "TDHes", "TDHeps")}
    by_step = [level(r.of_r1("TDHeps", step)) for step in (0.05, 0.1, 0.2, 0.5)]
    seconds = [float(r.of_r1(method).exponents[-1, 1]) * t for method in ("TDHcc", "TDHes")]
    off = [float(r.of_r1("DOP853", step).exponents[-1, 0] / r.of_r1("TM").exponents[-1, 0]) for step in (0.2, 0.5)]
    powers = {m: slopes(r.indices["R1"][m], DECADES["R1"]) for m in TRUSTED_METHODS}
    return [
        Claim(
            "Fig. 2 a, e",
            "λ1 and λ2 of R1 fall as 1/t by DOP853 and TM",
            f"t λ1 = {listed([r.of_r1(m).exponents[-1, 0] * t for m in TRUSTED_METHODS], '.2f')} at t = {t:.0e}",
            AGREED,
        ),
        Claim(
            "Table 1, TM",
            "λ1 = 1.5 (times a power of ten) at t = 1e8 and τ = 0.05",
            f"the C program has {witnessed('R1', 'TM', 1e8)} there; t λ1 grows as ln t, ours up to t = {t:.0e}",
            AGREED,
        ),
        Claim(
            "Fig. 2 b, c, d",
            "λ1 levels off by the three TDH methods, by TDHcc and TDHes at the same value, by TDHeps lowest",
            f"it does: {listed(levels.values())}",
            AGREED,
        ),
        Claim(
            "Table 1, TDH",
            "mantissas 9.4 of TDHcc and TDHes; 2.3, 8.9, 3.5 and 1.8 of TDHeps with τ = 0.05, 0.1, 0.2 and 0.5",
            f"{listed([levels['TDHcc']])}; {listed(by_step)}: the law τ² fits theirs, if they are 2.3e−5 to 1.8e−3",
            NOT_REPRODUCIBLE,
            f"the C program has {witnessed('R1', 'TDHcc', 1e7)} and {witnessed('R1', 'TDHeps', 1e7)}, as here; where "
            "a level lies depends on details of the implementation that the paper does not tell",
        ),
        Claim(
            "Fig. 2 b, c",
            "λ2 levels off too, by TDHcc and TDHes",
            f"t λ2 = {listed(seconds, '.2f')}: it falls as 1/t",
            CORRECTED,
            f"the C program has λ2 = {witnessed('R1', 'TDHcc', 1e7, 1)} at t = 1e7 by TDHcc, beside λ1 = "
            f"{witnessed('R1', 'TDHcc', 1e7)}; by TDHeps it does level off, at {witnessed('R1', 'TDHeps', 1e7, 1)}",
        ),
        Claim(
            "Fig. 2 g, h, i",
            "sums of pairs level off by the three TDH methods",
            f"{_sums(r, 'R1')}: they fall as 1/t",
            CORRECTED,
            SYMPLECTIC + constant("R1", "TDHcc", 1e7),
        ),
        Claim(
            "Fig. 3 a",
            "λ1 by DOP853 deviates from 1/t at τ = 0.2 and 0.5, by TM it does not",
            f"at t = {t:.0e} DOP853 has {listed(off, '.3f')} times the λ1 of TM",
            *_told(max(off) > 1.2, "the deviation comes at times beyond ours, with an energy that drifts"),
        ),
        Claim(
            "Fig. 3 b",
            "smaller steps of TDHeps push the level down and the time when it is reached up",
            f"levels {listed(by_step)}: as τ²",
            AGREED,
        ),
        Claim(
            "Fig. 4 a, e and (58)",
            "GALI2 of R1 is constant, GALI3 falls as t⁻², GALI4 as t⁻⁴, by DOP853 and TM",
            f"powers {listed(powers['DOP853'], '.2f')} and {listed(powers['TM'], '.2f')}",
            AGREED,
        ),
        Claim(
            "Fig. 4 b, c, d",
            "by the TDH methods they fall exponentially in the end, by TDHeps latest",
            "as exp(−(λ1 − λ2) t) with the λ1 that levels off",
            AGREED,
        ),
    ]


def _told(agrees: bool, reason: str) -> tuple[str, str]:
    return (AGREED, "") if agrees else (NOT_REPRODUCIBLE, reason)


def _about_c1(r: "skokos.Reproduction") -> list[Claim]:
    runs = r.of("C1")
    t = float(runs["TM"].time[-1])
    second = [float(run.exponents[-1, 1]) * t for run in runs.values()]
    return [
        Claim(
            "Fig. 5 a",
            "λ1 of C1 is practically the same by all methods",
            f"{listed([run.exponents[-1, 0] for run in runs.values()], '.4f')} at t = {t:.0e}: within 5 standard "
            "errors of 0.04434(22)",
            AGREED,
        ),
        Claim(
            "Fig. 5 a",
            "λ2 becomes negative after a time, where the methods reach their limit",
            f"t λ2 = {listed(second, '.1f')}: it goes on falling as 1/t",
            CORRECTED,
            f"the C program has λ2 = {witnessed('C1', 'DOP853', 1e7, 1)} at t = 1e7 by DOP853",
        ),
        Claim(
            "Fig. 5 b",
            "sums of pairs level off, at four digits",
            f"{_sums(r, 'C1')}: they fall as 1/t",
            CORRECTED,
            SYMPLECTIC + constant("C1", "DOP853", 1e7),
        ),
        Claim(
            "Fig. 5 c",
            "GALIs of C1 fall exponentially",
            "ln GALI2, ln GALI3, ln GALI4 as 1 : 2 : 4 by every method",
            AGREED,
        ),
    ]


def _about_c2(r: "skokos.Reproduction") -> list[Claim]:
    then = {m: float(early(r.of("C2")[m].time, r.of("C2")[m].exponents[:, 0])) for m in METHODS}
    fourth = [early(found.time, found.log_values[:, -1]) / np.log(10) for found in r.indices["C2"].values()]
    sure = [float(r.of("C2")[m].exponents[-1, 0]) for m in TRUSTED_METHODS]
    substitute = "with y = −0.01333, on which the C program ran too"
    return [
        Claim(
            "Fig. 6, start of C2",
            "y = −0.01344 (all digits that there are), weakly chaotic up to the end",
            "y = −0.01333 stays in the thin chaotic layer up to t = 1e8, λ1 = " + witnessed("C2", "TM", 1e8),
            NOT_REPRODUCIBLE,
            "from −0.01344 the orbit leaves for the big sea at t of 1e4 to 1e5 by every method: digits are lost",
        ),
        Claim(
            "Fig. 7 a, e",
            "DOP853 and TM find C2 weakly chaotic, with a small λ1",
            f"λ1 = {listed(sure)} at t = {r.lengths.exponents:.0e}",
            AGREED,
        ),
        Claim(
            "Fig. 7 b, c, d",
            "the TDH methods overestimate λ1 of C2",
            f"at t = 1e5 {', '.join(f'{m} {listed([v])}' for m, v in then.items())}: TDHcc and TDHes underestimate "
            "it, TDHeps has the size of it",
            CORRECTED,
            f"the C program has at t = 1e5 TDHcc {witnessed('C2', 'TDHcc', 1e5)}, TDHeps "
            f"{witnessed('C2', 'TDHeps', 1e5)}, TM {witnessed('C2', 'TM', 1e5)}, DOP853 "
            f"{witnessed('C2', 'DOP853', 1e5)} ({substitute})",
        ),
        Claim(
            "Fig. 7 g, h, i",
            "sums of pairs level off at larger values by the TDH methods than by DOP853 and TM",
            f"{_sums(r, 'C2')}: they fall as 1/t",
            CORRECTED,
            SYMPLECTIC + constant("C2", "TM", 1e8),
        ),
        Claim(
            "Fig. 8",
            "GALIs of C2 fall exponentially, by the TDH methods earlier than by DOP853 and TM",
            f"log10 GALI4 at t = 1e5 is {listed(fourth, '.0f')} by {', '.join(METHODS)}: by TDHcc and TDHes they "
            "still follow the powers of t when those of DOP853 and TM have fallen",
            CORRECTED,
            f"they fall as λ1 − λ2 says, which the C program has as "
            f"{(WITNESS['C2', 'TDHcc', 1e5][0] - WITNESS['C2', 'TDHcc', 1e5][1]):.0e} by TDHcc and "
            f"{(WITNESS['C2', 'TM', 1e5][0] - WITNESS['C2', 'TM', 1e5][1]):.0e} by TM at t = 1e5 ({substitute})",
        ),
    ]


def _about_more_freedoms(r: "skokos.Reproduction") -> list[Claim]:
    two, eps = r.of("R2"), r.of("R2")["TDHeps"]
    powers = {o: {m: slopes(r.indices[o][m], DECADES[o]) for m in TRUSTED_METHODS} for o in ("R2", "R3")}
    fallen = r.indices["R2"]["TDHeps"].log_values[-1, 0] / np.log(10)
    off = {o: max(float(np.max(np.abs(p - law(ORBITS[o])))) for p in found.values()) for o, found in powers.items()}
    return [
        Claim(
            "Fig. 9 a, c, d, f",
            "exponents and sums of R2 fall as 1/t by DOP853 and TM",
            f"t λ1 = {listed([two[m].exponents[-1, 0] * two[m].time[-1] for m in TRUSTED_METHODS], '.2f')}",
            AGREED,
        ),
        Claim("Fig. 9 b", "λ1 of R2 levels off by TDHeps", f"at {listed([level(eps)])}", AGREED),
        Claim(
            "Fig. 9 b",
            "λ3 by TDHeps becomes negative after a time",
            f"λ3 = {listed([eps.exponents[-1, 2]])} at t = {eps.time[-1]:.0e}",
            *_told(
                bool(eps.exponents[-1, 2] < 0),
                "what is below 1/t depends on the deviation vectors at the start, which the paper does not tell",
            ),
        ),
        Claim(
            "Fig. 9 e",
            "the sum λ1 + λ6 levels off by TDHeps",
            f"{_sums(r, 'R2')}: it falls as 1/t",
            CORRECTED,
            "the tangent of each step of TDHeps is symplectic, so that a sum is at most a constant over t",
        ),
        Claim(
            "Fig. 10 and (59)",
            "GALIs of R2 follow their powers of t by DOP853 and TM, and fall exponentially by TDHeps",
            f"powers to {off['R2']:.2f}; by TDHeps GALI2 is 10^{listed([fallen], '.0f')} at the end",
            AGREED,
        ),
        Claim(
            "Fig. 11 a, c, d, f",
            "GALIs of R3 show its torus of four dimensions by DOP853 and TM",
            f"powers to {off['R3']:.2f}",
            AGREED,
        ),
        _about_r3(r),
    ]


def _about_r3(r: "skokos.Reproduction") -> Claim:
    found = r.indices["R3"]["TDHeps"]
    logs, t = np.asarray(found.log_values)[:, 0] / np.log(10), np.asarray(found.time)
    top = int(np.argmax(np.where(t > 1e5, logs, -np.inf)))
    hump = f"they rise again, GALI2 to 10^{listed([logs[top]], '.2f')} at t = {t[top]:.0e}"
    last = f"10^{listed([logs[-1]], '.1f')} at t = {t[-1]:.0e}"
    fell = bool(logs[-1] < FALLEN_GALI2)
    end = f"{hump}, and then fall, to {last}" if fell else f"{hump}; no exponential fall yet: {last}"
    return Claim(
        "Fig. 11 b, e",
        "by TDHeps they follow the laws for a time, then fall exponentially",
        end,
        *_told(
            fell,
            f"this run is too short for it, one of full length shows it: λ1 levels off at 4e−6 only. The C program has "
            f"GALI2 = {witnessed('R3', 'TDHeps', 1e6)} at t = 1e6 too, beside {witnessed('R3', 'TM', 1e6)} by TM",
        ),
    )


def _about_times(r: "skokos.Reproduction") -> list[Claim]:
    """Claims about times: reported only, because they depend on the machine and the implementation."""
    seconds = {(row.method, row.step, row.threshold): s for row, s in zip(TABLE, r.seconds, strict=True)}
    of = {method: next(s for (m, step, _), s in seconds.items() if (m, step) == (method, 0.05)) for method in METHODS}
    ratios = ", ".join(f"{method} {of[method] / of['TM']:.2f}" for method in METHODS if method != "TM")
    machine = "times depend on the machine and on how a method is written; here all is compiled, columns in vectors"
    return [
        Claim(
            "Table 1, §VII.1.1",
            "TM takes the least time of all at the same step, DOP853 the most",
            f"times over that of TM at τ = 0.05: {ratios}",
            *_told(min(of, key=lambda m: of[m]) == "TM" and max(of, key=lambda m: of[m]) == "DOP853", machine),
        ),
        Claim(
            "Table 1",
            "CPU times",
            "they stand beside ours in the table",
            NOT_REPRODUCIBLE,
            "an ordinary personal computer of 2010",
        ),
    ]
