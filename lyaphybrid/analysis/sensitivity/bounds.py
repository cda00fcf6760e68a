"""Bounds on parameters, by coordinates u without bounds in which the search runs."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second

from ..._arguments import require
from .estimates import ExponentFunction

__all__ = ["ParameterBounds", "bounds_of"]

LONGEST_LOG_STEP = 2.0  # largest step in the logarithm of a distance from a bound …
HALF = 0.5  # … and, relative to its size, of a parameter without bounds


class ParameterBounds(NamedTuple):
    """Bounds of each parameter; ±∞ where there is none.

    Between two bounds θ = a + (b − a)/(1 + e^(−u)), above one θ = a + e^u, below one θ = b − e^(−u), else θ = u.
    """

    low: np.ndarray  # (p,)
    high: np.ndarray  # (p,)

    def bounded(self, u: np.ndarray) -> np.ndarray:
        """θ at coordinates u."""
        between, above, below = self._kinds()
        theta = u.copy()
        theta[above] = self.low[above] + np.exp(u[above])
        theta[below] = self.high[below] - np.exp(-u[below])
        theta[between] = self.low[between] + (self.high - self.low)[between] * scipy.special.expit(u[between])
        return theta

    def unbounded(self, theta: np.ndarray) -> np.ndarray:
        """The coordinates u of θ."""
        between, above, below = self._kinds()
        u = theta.astype(float)
        u[above] = np.log((theta - self.low)[above])
        u[below] = -np.log((self.high - theta)[below])
        u[between] = np.log((theta - self.low)[between] / (self.high - theta)[between])
        return u

    def slope(self, u: np.ndarray) -> np.ndarray:
        """dθ/du."""
        between, above, below = self._kinds()
        slope = np.ones_like(u)
        slope[above], slope[below] = np.exp(u[above]), np.exp(-u[below])
        share = scipy.special.expit(u[between])
        slope[between] = (self.high - self.low)[between] * share * (1 - share)
        return slope

    def longest(self, u: np.ndarray) -> np.ndarray:
        """The longest step to try in u; beyond it exponents are not linear any more."""
        between, above, below = self._kinds()
        free = ~(between | above | below) & (u != 0)
        longest = np.where(between | above | below, LONGEST_LOG_STEP, np.inf)
        longest[free] = HALF * np.abs(u[free])
        return longest

    def sizes(self, theta: np.ndarray) -> np.ndarray:
        """(p,) the size of each parameter θ without bounds; 1 of one that is zero, and of one with bounds."""
        free = ~np.any(self._kinds(), axis=0)
        return np.where(free & (theta != 0), np.abs(theta), 1.0)

    def both(self) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of the only parameter."""
        good = len(self.low) == 1 and bool(np.isfinite(self.low[0]) and np.isfinite(self.high[0]))
        got = ", ".join(f"({low:g}, {high:g})" for low, high in zip(self.low, self.high, strict=True))
        require(good, f"a bisection needs one free parameter with both bounds, over={{name: (low, high)}}; got {got}.")
        return self.low, self.high

    def _kinds(self):
        """Masks (p,) of parameters with both bounds, only a lower one, only an upper one."""
        low, high = np.isfinite(self.low), np.isfinite(self.high)
        return low & high, low & ~high, high & ~low


def bounds_of(case: ExponentFunction, over: Mapping) -> ParameterBounds:
    """The bounds of a case's parameters, {name: (low, high) or None}; of an array they hold for each element."""
    leaves = [name.split("[")[0] for name in case.names]
    pairs: list[Any] = [(None, None) if over[name] is None else over[name] for name in leaves]
    require(all(np.shape(pair) == (2,) for pair in pairs), f"bounds must be pairs (low, high); got {over!r}.")
    low = np.array([-np.inf if pair[0] is None else pair[0] for pair in pairs], float)
    high = np.array([np.inf if pair[1] is None else pair[1] for pair in pairs], float)
    for name, value, a, b in zip(case.names, case.theta, low, high, strict=True):
        require(a < value < b, f"args must lie between the bounds: {name} = {value:.6g} is not in ({a:.6g}, {b:.6g}).")
    return ParameterBounds(low, high)
