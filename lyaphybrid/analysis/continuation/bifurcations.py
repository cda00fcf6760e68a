"""Test functions of bifurcations: functions of a point of a branch that change sign there."""

from typing import Any, NamedTuple

import numpy as np

from ..._linalg.products import in_units
from ..orbits.families import family_of
from ..orbits.multipliers import multipliers_of
from ..orbits.periodic_orbits import in_any_case
from ..orbits.shooting import OrbitIterate
from .equations import BranchEquations, BranchPoint

__all__ = ["TESTS", "across_flow", "branching", "cycle_of_events", "is_complex", "monodromy", "of_doubling"]

NUDGE = 1e-5  # step of the finite differences of the Jacobian
PARAMETER_UNCHANGED = 1e-4  # a direction with a smaller parameter component does not change the parameter
REAL_MULTIPLIER = 1e-6  # a multiplier with a smaller imaginary part is real


def monodromy(equations: BranchEquations, orbit: OrbitIterate) -> np.ndarray:
    """The monodromy matrix (n, n) at the first node, modulo the symmetry."""
    first = orbit.nodes[0]
    matrix = np.eye(len(first.x))
    for piece in orbit.pieces:
        matrix = piece.matrix @ matrix
    if equations.symmetry is None:
        return matrix
    return np.linalg.solve(equations.symmetry.image(first.x, orbit.shift).by_state, matrix)


def transverse(equations: BranchEquations, point: BranchPoint) -> np.ndarray:
    """The multipliers of a point, without the 1 along the flow of an autonomous system.

    It is divided out by its eigenvector, the velocity, because next to a fold or a branch point two are near 1.
    """
    if equations.symmetry is not None or equations.conserved is not None:
        matrix, flow = monodromy(equations, point.orbit), equations.motion(point.parameter)
        family = family_of(flow, point.orbit, equations.autonomous, equations.fixed)
        known = in_any_case(flow, point.orbit, equations.autonomous, family)
        return multipliers_of([matrix], known, len(matrix), equations.autonomous).deciding
    return np.linalg.eigvals(across_flow(equations, point.orbit, point.parameter)).astype(complex)


def across_flow(equations: BranchEquations, orbit: OrbitIterate, p: float) -> np.ndarray:
    """The scaled monodromy matrix on the quotient by the flow, if any, without symmetry or conservation."""
    matrix = in_units(monodromy(equations, orbit), equations.sizes)
    if not equations.autonomous:
        return matrix
    velocity = equations.motion(p).velocity(orbit.nodes[0]) / equations.sizes
    across = np.linalg.svd(velocity[None, :])[2][1:]
    return across @ matrix @ across.T


def _signed(factors: np.ndarray) -> float:
    """The smallest |factor|, with the sign of the product of all factors, which is real."""
    if not len(factors):
        return 1.0
    sizes = np.abs(factors)
    sign = np.prod(np.where(sizes > 0, factors / np.where(sizes > 0, sizes, 1.0), 0.0)).real
    return float(np.sign(sign) * np.min(sizes))


def fold(equations: BranchEquations, point: BranchPoint) -> float:
    """The component of the tangent along the parameter."""
    del equations
    return float(point.tangent[-1])


def branch(equations: BranchEquations, point: BranchPoint) -> float:
    """Smallest singular value of [Jacobian; tangent], with the sign of the determinant."""
    del equations
    square = np.vstack([point.jacobian, point.tangent])
    return float(np.linalg.slogdet(square)[0] * np.linalg.svd(square, compute_uv=False)[-1])


def doubling(equations: BranchEquations, point: BranchPoint) -> float:
    """The factor of Π (μ + 1) next to zero, with the sign of the product."""
    return _signed(transverse(equations, point) + 1)


def torus(equations: BranchEquations, point: BranchPoint) -> float:
    """The factor of Π_{i<j} (μ_i μ_j − 1) next to zero, with the sign of the product."""
    multipliers = transverse(equations, point)
    i, j = np.triu_indices(len(multipliers), 1)
    return _signed(multipliers[i] * multipliers[j] - 1)


TESTS = {"branch point": branch, "fold": fold, "period doubling": doubling, "Neimark–Sacker": torus}


def is_complex(equations: BranchEquations, point: BranchPoint) -> bool:
    """Whether the pair of multipliers whose product is 1 is complex: a real pair is no Neimark–Sacker point."""
    multipliers = transverse(equations, point)
    i, j = np.triu_indices(len(multipliers), 1)
    at = int(np.argmin(np.abs(multipliers[i] * multipliers[j] - 1)))
    return bool(abs(np.imag(multipliers[i[at]])) > REAL_MULTIPLIER)


class Branching(NamedTuple):
    """Another branch through a point."""

    kind: str
    direction: np.ndarray  # (N + 1,) its tangent


def branching(equations: BranchEquations, point: BranchPoint) -> Branching:
    """The kind of a branch point, and the tangent of the branch that crosses there.

    The tangent of a branch is a direction α v + β τ in the null space of the Jacobian, with τ the tangent of the known
    branch and v orthogonal to it, that satisfies a α² + 2 b αβ = 0, where a = ψ·J'v v, b = ψ·J'v τ and ψ is the left
    null vector.
    """
    left, _, right = np.linalg.svd(point.jacobian)
    psi, null = left[:, -1], right[-2:]
    along = null.T @ (null @ point.tangent)
    along /= np.linalg.norm(along)
    across = null.T @ (np.array([[0.0, -1.0], [1.0, 0.0]]) @ (null @ along))
    change = psi @ _derivative(equations, point, across)
    own, mixed = change @ across, change @ along
    direction = 2 * mixed * across - own * along
    direction /= np.linalg.norm(direction)
    flat = min(abs(direction[-1]), abs(along[-1])) < PARAMETER_UNCHANGED
    return Branching("pitchfork" if flat else "transcritical", direction)


def _derivative(equations: BranchEquations, point: BranchPoint, along: np.ndarray) -> np.ndarray:
    """The derivative of the Jacobian (N, N + 1) along a direction, by central differences of fourth order."""

    def difference(nudge: float) -> np.ndarray:
        ends = (equations.shoot(point.u + side * nudge * along, point.orbit) for side in (1.0, -1.0))
        ahead, behind = (equations.linearised(orbit, p)[0] for orbit, p in ends)
        return (ahead - behind) / (2 * nudge)

    return (4 * difference(NUDGE) - difference(2 * NUDGE)) / 3


def of_doubling(equations: BranchEquations, point: BranchPoint) -> np.ndarray:
    """The change (n,) of the first node towards the doubled orbit: the eigenvector of the multiplier −1."""
    values, vectors = np.linalg.eig(in_units(monodromy(equations, point.orbit), equations.sizes))
    vector = np.real(vectors[:, np.argmin(np.abs(values + 1))])
    return equations.sizes * vector / np.linalg.norm(vector)


def cycle_of_events(orbit: OrbitIterate) -> tuple[Any, ...]:
    """The cyclic sequence of the jumps of a period, in a form that does not depend on where it starts."""
    found: list[tuple[int, ...]] = []
    for piece in orbit.pieces:
        if piece.events is not None:
            columns = (piece.events.transition, piece.events.mode_before, piece.events.mode_after)
            rows = np.column_stack([*columns, piece.events.which])
            found += [tuple(int(value) for value in row) for row in rows]
    return min((tuple(found[i:] + found[:i]) for i in range(len(found))), default=())
