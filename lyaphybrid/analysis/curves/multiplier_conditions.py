"""Conditions on the multipliers: fold, branch point, period doubling, Neimark–Sacker.

That a matrix A is singular is the one equation g = 0 of the bordered system

    A w + B g = 0,   C·w = 1,

whose derivatives are −ψ·(∂A) w with ψ from the transposed system. A holds first derivatives of the motion, ∂A second
ones; as these are symmetric, ψ·(∂A) w is the derivative along w of the first derivatives by all unknowns: two
differences, however many unknowns there are.

Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (Springer 2004), sections 10.2 and 10.3,
doi:10.1007/978-1-4757-3978-7.
"""

from typing import NamedTuple

import numpy as np

from ..._linalg.products import in_units
from ..continuation.bifurcations import monodromy
from .equations import EXACTLY, ConditionValue, CurveIterate

__all__ = ["BranchPointCondition", "DoublingCondition", "FoldCondition", "TorusCondition"]


class Bordered(NamedTuple):
    """The solution of a bordered system with as many borders as A has singular values near zero."""

    g: np.ndarray  # (d, d)
    w: np.ndarray  # (n, d) null vectors of A, where g = 0
    psi: np.ndarray  # (n, d) left null vectors
    left: np.ndarray  # (n, d) the border B


def bordered(matrix: np.ndarray, defect: int) -> Bordered:
    """The bordered system of a square matrix, its borders the singular vectors."""
    n = len(matrix)
    left, _, right = np.linalg.svd(matrix)
    b, c = left[:, n - defect :], right[n - defect :].T
    square = np.block([[matrix, b], [c.T, np.zeros((defect, defect))]])
    unit = np.vstack([np.zeros((n, defect)), np.eye(defect)])
    straight, transposed = np.linalg.solve(square, unit), np.linalg.solve(square.T, unit)
    return Bordered(straight[n:], straight[:n], transposed[:n], b)


class FoldCondition(NamedTuple):
    """Two orbits meet: the Jacobian by all unknowns but the parameters is singular."""

    unknowns: int = 0
    beside: tuple[float, ...] = EXACTLY

    def at(self, there: CurveIterate) -> ConditionValue:
        """Residual and derivatives."""
        found = bordered(there.jacobian[:, :-2], 1)
        row = -found.psi[:, 0] @ there.second(np.append(found.w[:, 0], [0.0, 0.0]))
        return ConditionValue(found.g[0], row[None, :], np.zeros((len(there.gaps), 0)))


class BranchPointCondition(NamedTuple):
    """Two branches cross: what folds, and the parameter does not unfold it.

    In two parameters this is one condition too many. It holds along a curve where a symmetry, or an orbit that is there
    anyway, demands it: then the force α along the border B, which is one more unknown, is zero.
    """

    unknowns: int = 1
    beside: tuple[float, ...] = EXACTLY

    def at(self, there: CurveIterate) -> ConditionValue:
        """Residuals and derivatives."""
        matrix, by_first = there.jacobian[:, :-2], there.jacobian[:, -2]
        found = bordered(matrix, 1)
        psi, w = found.psi[:, 0], found.w[:, 0]
        known = np.linalg.lstsq(np.vstack([matrix, w]), np.append(by_first, 0.0), rcond=None)[0]
        rows = np.array(
            [-psi @ there.second(np.append(w, [0.0, 0.0])), psi @ there.second(np.append(-known, [1.0, 0.0]))]
        )
        residuals = np.array([found.g[0, 0], psi @ by_first])
        return ConditionValue(residuals, np.hstack([rows, np.zeros((2, 1))]), found.left)


def _back(there: CurveIterate) -> np.ndarray:
    """The scaled inverse (n, n) of the derivative of the symmetry; the identity without one."""
    first, symmetry = there.orbit.nodes[0], there.branch.symmetry
    if symmetry is None:
        return np.eye(len(first.x))
    return np.linalg.inv(in_units(symmetry.image(first.x, there.orbit.shift).by_state, there.branch.sizes))


def _matrices(there: CurveIterate) -> list[np.ndarray]:
    """The scaled derivatives (n, n) of the pieces."""
    return [in_units(piece.matrix, there.branch.sizes) for piece in there.orbit.pieces]


def _whole(there: CurveIterate) -> np.ndarray:
    """The scaled monodromy matrix (n, n)."""
    return in_units(monodromy(there.branch, there.orbit), there.branch.sizes)


def _bent(there: CurveIterate, w: np.ndarray) -> np.ndarray:
    """The derivatives (states, N + 2) of M_i w_i, what each piece makes of what w has become, by all unknowns."""
    matrices, ahead = _matrices(there), [w]
    for matrix in matrices[:-1]:
        ahead.append(matrix @ ahead[-1])
    states = len(matrices) * len(w)
    direction = np.append(np.concatenate(ahead) / np.sqrt(len(matrices)), np.zeros(len(there.u) - states))
    return there.second(direction)[:states]


def _through(there: CurveIterate, psi: np.ndarray) -> np.ndarray:
    """The weights (states,) of the ends of the pieces in ψ·M w, M the monodromy matrix."""
    behind = [_back(there).T @ psi]
    for matrix in reversed(_matrices(there)[1:]):
        behind.insert(0, matrix.T @ behind[0])
    return np.concatenate(behind)


class DoublingCondition(NamedTuple):
    """One multiplier is −1: M + I is singular."""

    unknowns: int = 0
    beside: tuple[float, ...] = EXACTLY

    def at(self, there: CurveIterate) -> ConditionValue:
        """Residual and derivatives."""
        matrix = _whole(there)
        found = bordered(matrix + np.eye(len(matrix)), 1)
        row = -_through(there, found.psi[:, 0]) @ _bent(there, found.w[:, 0])
        return ConditionValue(found.g[0], row[None, :], np.zeros((len(there.gaps), 0)))


class TorusCondition(NamedTuple):
    """Two multipliers are exp(±iθ): M² − 2κM + I has two null vectors; κ = cos θ is one more unknown."""

    unknowns: int = 1
    beside: tuple[float, ...] = EXACTLY

    def at(self, there: CurveIterate) -> ConditionValue:
        """Residuals and derivatives."""
        matrix, kappa = _whole(there), float(there.own[0])
        found = bordered(matrix @ matrix - 2 * kappa * matrix + np.eye(len(matrix)), 2)
        # One null vector and its image span the plane; of the two the one that turns more is taken.
        turned = np.linalg.norm(matrix @ found.w - kappa * found.w, axis=0)
        i = int(np.argmax(turned))
        w = found.w[:, i]
        once, twice, rows = _bent(there, w), _bent(there, matrix @ w), []
        for psi in found.psi.T:
            by_state = _through(there, psi) @ twice + _through(there, matrix.T @ psi - 2 * kappa * psi) @ once
            rows.append(-np.append(by_state, -2 * psi @ matrix @ w))
        return ConditionValue(found.g[:, i], np.array(rows), np.zeros((len(there.gaps), 1)))
