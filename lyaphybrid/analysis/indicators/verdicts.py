"""Regular, chaotic or undecided: the verdict of an indicator, with its reason."""

from typing import NamedTuple

import numpy as np

__all__ = ["ATTRACTED", "Verdict", "grows", "of_alignment", "of_fli", "of_megno", "of_volumes"]

FEWEST_TIMES = 8  # least number of recorded times for a verdict
STEEP = 8.0  # GALI_2 and SALI of regular motion fall slower than t^-8 (t^-2 with one degree of freedom)
TWO = 0.25  # the mean MEGNO of regular motion differs from 2 by less than this
GROWS_BESIDE = 0.1  # least growth of a deviation vector, relative to the fall of GALI, that counts
CLEARLY = 6.0  # chaos needs a larger mean MEGNO


class Verdict(NamedTuple):
    """The verdict of an indicator on an orbit, with the time over which the orbit was followed."""

    kind: str  # "regular" | "chaotic" | "undecided"
    reason: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}"


ATTRACTED = Verdict(
    "undecided",
    "it falls exponentially, but no deviation vector grows: an attractor aligns them, whether it is chaotic or not; "
    "lh.fli or lh.lyapunov_spectrum tells",
)


def _late(time, values):
    """The points of the second half, in the logarithm of the time."""
    good = np.isfinite(time) & (time > 0)
    time, values = time[good], values[good]
    if len(time) < FEWEST_TIMES:
        return time[:0], values[:0]
    late = np.log(time) >= 0.5 * (np.log(time[0]) + np.log(time[-1]))
    return time[late], values[late]


def of_alignment(time: np.ndarray, logs: np.ndarray) -> Verdict:
    """From ln GALI_2 or ln SALI (times,): a power of the time, or an exponential."""
    t, y = _late(time, logs)
    if len(t) < FEWEST_TIMES // 2:
        return Verdict("undecided", f"fewer than {FEWEST_TIMES} times")
    if np.any(np.isneginf(y)):
        return Verdict(
            "undecided", "a jump destroyed a direction: deviation vectors are aligned whatever the motion is"
        )
    power = -np.polyfit(np.log(t), y, 1)[0]
    rate = -np.polyfit(t, y, 1)[0]
    fell = y[0] - y[-1]
    if power > STEEP and fell > STEEP * np.log(t[-1] / t[0]):
        return Verdict("chaotic", f"it falls like exp(-{rate:.3g} t), faster than any power that regular motion has")
    if power < 3.0:
        return Verdict("regular", f"over the second half it goes like t^{-power:+.2f}: no exponential decay")
    return Verdict("undecided", f"it falls like t^{-power:.1f}: follow the orbit for longer")


def grows(time: np.ndarray, growth: np.ndarray, logs: np.ndarray) -> bool:
    """Whether ln of a deviation vector's length (times,) grows exponentially, where ln GALI_2 (times,) falls so.

    Where volume is conserved λ₁ is half of the rate at which it falls; on an attractor only its own growth tells.
    """
    (t, y), (_, falling) = _late(time, growth), _late(time, logs)
    rate, fall = np.polyfit(t, y, 1)[0], -np.polyfit(t, falling, 1)[0]
    return bool(rate > GROWS_BESIDE * fall) or of_fli(time, growth).kind == "chaotic"


def of_volumes(time: np.ndarray, logs: np.ndarray, orders: tuple[int, ...]) -> Verdict:
    """From ln GALI_k (times, orders), by order 2, unless order 3 says that two vectors can tell nothing."""
    if 2 not in orders:
        return Verdict("undecided", f"orders {orders} have no 2, which tells regular from chaotic motion")
    found = of_alignment(time, logs[:, orders.index(2)])
    if found.kind == "regular" and 3 in orders and of_alignment(time, logs[:, orders.index(3)]).kind == "chaotic":
        return Verdict(
            "undecided",
            "GALI2 does not fall, but GALI3 falls exponentially: the two largest exponents are equal, of chaos or of a "
            "torus that attracts; lh.fli tells which",
        )
    return found


def of_megno(time: np.ndarray, means: np.ndarray) -> Verdict:
    """From the mean MEGNO (times,): 2 for quasiperiodic motion, λt/2 in chaos."""
    t, y = _late(time, means)
    if len(t) < FEWEST_TIMES // 2:
        return Verdict("undecided", f"fewer than {FEWEST_TIMES} times")
    if not np.all(np.isfinite(y)):
        return Verdict("undecided", "a jump destroyed the deviation vector")
    rate, last = np.polyfit(t, y, 1)[0], y[-1]
    if last > CLEARLY and rate * t[-1] > 0.5 * last:
        return Verdict("chaotic", f"its mean grows like {rate:.3g} t")
    if abs(last - 2) < TWO or last < 2:
        return Verdict("regular", f"its mean stands at {last:.2f}")
    return Verdict("undecided", f"its mean stands at {last:.2f}: follow the orbit for longer")


def of_fli(time: np.ndarray, values: np.ndarray) -> Verdict:
    """From the FLI or OFLI (times,): the logarithm of a power of the time, or linear in time."""
    t, y = _late(time, values)
    if len(t) < FEWEST_TIMES // 2:
        return Verdict("undecided", f"fewer than {FEWEST_TIMES} times")
    power, rate = np.polyfit(np.log(t), y, 1)[0], np.polyfit(t, y, 1)[0]
    if power > STEEP:
        return Verdict("chaotic", f"it grows like {rate:.3g} t")
    if power < 3.0:
        return Verdict("regular", f"it grows like {power:.2f} ln t")
    return Verdict("undecided", f"it grows like {power:.1f} ln t: follow the orbit for longer")
