"""The equations of a bifurcation curve: those of a periodic orbit, and one condition, in two parameters.

The unknowns z = (u, p, q, e) are those of the orbit, the two parameters, and what the condition adds: nothing, or an
angle, a time. They are one more than the equations, so that the curve has a tangent, as a branch has, and passes its
own folds in p or q.

W. J. F. Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria (SIAM 2000), doi:10.1137/1.9780898719543;
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (Springer 2004), chapter 10, doi:10.1007/978-1-4757-3978-7.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from ...errors import RunFailedError
from ..continuation.equations import BranchEquations, ParameterOf, solved, tangent
from ..orbits.motion.motions import Motion
from ..orbits.periodic_orbits import CONVERGED
from ..orbits.shooting import OrbitIterate

__all__ = ["EXACTLY", "Condition", "ConditionValue", "CurveEquations", "CurvePoint", "CurveIterate", "first_that_runs"]

EXACTLY = (0.0,)
SECOND_DIFFERENCE = 1e-4  # step, in scaled unknowns, of the differences of the Jacobian
CURVE_ITERATIONS = 10  # of Newton's method
CURVE_RESIDUAL = 1e-12  # of the condition, where Newton's method may stop
STILL_GAINS = 0.25  # Newton's method goes on while a step reduces what is left to less than this fraction


def first_that_runs(run: Callable[[float], Any], shifts: tuple[float, ...]) -> Any:
    """What a run gives with the first of the shifts with which it does not fail."""
    *others, last = shifts
    for shift in others:
        try:
            return run(shift)
        except RunFailedError:
            continue
    return run(last)


class ConditionValue(NamedTuple):
    """The residuals of a condition with e unknowns of its own, and their derivatives."""

    residuals: np.ndarray  # (e + 1,)
    rows: np.ndarray  # (e + 1, N + 2 + e) derivatives by z
    forces: np.ndarray  # (N, e) what its unknowns add to the equations of the orbit, linearly


class Condition(Protocol):
    """What holds along a curve, besides that there is an orbit."""

    @property
    def unknowns(self) -> int:
        """How many unknowns it adds: e."""
        ...

    @property
    def beside(self) -> tuple[float, ...]:
        """Shifts of the first parameter, relative to its range, with which a motion is tried, in turn."""
        ...

    def at(self, there: "CurveIterate") -> ConditionValue:
        """Residuals and derivatives at an iterate."""
        ...


class CurveIterate(NamedTuple):
    """An iterate of Newton's method, with the linearised equations of its orbit."""

    equations: "CurveEquations"
    orbit: OrbitIterate
    pair: tuple[float, float]  # p, q
    own: np.ndarray  # (e,) unknowns of the condition
    jacobian: np.ndarray  # (N, N + 2)
    gaps: np.ndarray  # (N,)
    u: np.ndarray  # (N + 2,) scaled unknowns without those of the condition

    @property
    def branch(self) -> BranchEquations:
        """The equations of the branch in p through this orbit."""
        return self.equations.along(0, self.pair)

    @property
    def motion(self) -> Motion:
        """The motion at these parameters."""
        return self.branch.motion(self.pair[0])

    def second(self, direction: np.ndarray) -> np.ndarray:
        """The derivative (N, N + 2) of the Jacobian along a direction (N + 2,) of the unknowns."""
        length = float(np.linalg.norm(direction))
        if length == 0.0:
            return np.zeros_like(self.jacobian)
        step = SECOND_DIFFERENCE / length
        ahead, behind = (
            self.equations.linearised(self.u + side * step * direction, self.orbit).jacobian for side in (1.0, -1.0)
        )
        return (ahead - behind) / (2 * step)


class CurvePoint(NamedTuple):
    """A point of a curve."""

    orbit: OrbitIterate
    pair: tuple[float, float]
    own: np.ndarray  # (e,)
    u: np.ndarray  # (N + 2 + e,) all unknowns, scaled
    tangent: np.ndarray  # (N + 2 + e,) of length 1
    iterations: int
    limit: "CurvePoint | None" = None  # the equilibrium to which the orbits shrink from here, at the end of a curve

    def parameters_along(self, unknowns: int) -> np.ndarray:
        """The components (2,) of the tangent along both parameters."""
        return self.tangent[len(self.tangent) - unknowns - 2 : len(self.tangent) - unknowns]


class CurveEquations(NamedTuple):
    """A branch in the first parameter, the second one, and the condition."""

    base: BranchEquations
    args_of: ParameterOf  # of the first parameter
    entries: tuple[int, int]  # of both parameters in the leaf of args
    spans: tuple[float, float]
    condition: Condition

    def along(self, which: int, pair: tuple[float, float]) -> BranchEquations:
        """The equations of the branch in one of the two parameters, through a pair of values."""
        own = ParameterOf(self.args_of.args_of, self.leaf(pair), self.entries[which])
        return self.base._replace(args_of=own, span=self.spans[which])

    def leaf(self, pair: tuple[float, float]) -> np.ndarray:
        """The leaf of args (L,) with both parameters."""
        leaf = np.array(self.args_of.leaf, float)
        leaf[list(self.entries)] = pair
        return leaf

    def vector(self, orbit: OrbitIterate, pair: tuple[float, float], own: np.ndarray) -> np.ndarray:
        """The unknowns z."""
        u = self.along(0, pair).vector(orbit, pair[0])
        return np.concatenate([u, [pair[1] / self.spans[1]], own])

    def linearised(self, z: np.ndarray, like: OrbitIterate) -> CurveIterate:
        """The orbit with these unknowns, and the Jacobian of its equations."""
        known = len(self.base.scales(like)) + 1
        u, own = z[:known], z[known:]
        orbit, pair = self._shot(u, like)
        first = self.along(0, pair)
        jacobian, gaps = first.linearised(orbit, pair[0])
        second = self.along(1, pair).linearised(orbit, pair[1])[0][:, -1:]
        # What the motion itself removes, such as a component across a constraint, is no unknown's value any more.
        projected = np.append(first.vector(orbit, pair[0]), u[-1])
        return CurveIterate(self, orbit, pair, own, np.hstack([jacobian, second]), gaps, projected)

    def _shot(self, u: np.ndarray, like: OrbitIterate) -> tuple[OrbitIterate, tuple[float, float]]:
        """The orbit with these unknowns, and both parameters; the first one a little beside where none has a motion."""

        def shot_beside(shift: float) -> tuple[OrbitIterate, tuple[float, float]]:
            pair = float((u[-2] + shift) * self.spans[0]), float(u[-1] * self.spans[1])
            return self.along(0, pair).shoot(np.append(u[:-2], pair[0] / self.spans[0]), like)[0], pair

        return first_that_runs(shot_beside, self.condition.beside)

    def corrected(
        self, guess: np.ndarray, like: OrbitIterate, across: np.ndarray, level: float, reach: float = np.inf
    ) -> CurvePoint | None:
        """The point of the curve near a guess on the hyperplane across·z = level; None without convergence."""
        z, before = guess, np.inf
        for iteration in range(CURVE_ITERATIONS):
            try:
                there = self.linearised(z, like)
                condition = self.condition.at(there)
            except (RunFailedError, ValueError, np.linalg.LinAlgError):
                return None
            z = np.concatenate([there.u, there.own])
            jacobian = np.vstack([np.hstack([there.jacobian, condition.forces]), condition.rows])
            if not np.all(np.isfinite(jacobian)):
                return None
            gaps = np.concatenate([there.gaps + condition.forces @ there.own, condition.residuals])
            left = max(there.orbit.residual, float(np.max(np.abs(condition.residuals))))
            good = there.orbit.residual <= CONVERGED and np.max(np.abs(condition.residuals)) <= CONVERGED
            if good and not CURVE_RESIDUAL < left < STILL_GAINS * before:
                return CurvePoint(there.orbit, there.pair, there.own, z, tangent(jacobian, across), iteration)
            if iteration > 2 and not left < before:
                return None
            before = left
            z = z + solved(jacobian, across, np.append(-gaps, level - across @ z))
            if not np.linalg.norm(z - guess) <= reach:
                return None
        return None
