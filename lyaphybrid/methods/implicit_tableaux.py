"""Coefficients of singly diagonally implicit methods with an explicit first stage.

ESDIRK34 of Jørgensen, Kristensen & Thomsen is what stage order 2, L-stability of its third-order weights and order 4 of
the others leave: γ is a root of 6γ³ − 18γ² + 9γ − 1. Going on by the weights of order 4, as Linh et al. do, gives up
L-stability: |R(z)| grows like 0.31 |z|.
"""

import diffrax
import numpy as np

from .runge_kutta import Tableau

__all__ = ["IMPLICIT"]


def _from_diffrax(solver: type, order: int) -> Tableau:
    table = solver.tableau
    return Tableau(
        table.a_lower, table.b_sol, tuple(table.c), (table.b_error,), order, table.fsal, float(table.a_diagonal[-1])
    )


def _esdirk34() -> Tableau:
    g = GAMMA34
    third = (0.102399400619911, -0.3768784522555561, 0.8386125301271861, g)
    fourth = np.array([0.15702489786032495, 0.11733044137043885, 0.6166780303921214, 0.10896663037711475])
    rows = ((g,), (0.1407377747247062, -0.1083655513813208), third[:3])
    return Tableau(rows, fourth, (2 * g, 0.4682387448518444, 1.0), (fourth - third,), 4, False, g)


GAMMA34 = 0.435866521508459
IMPLICIT = {
    "esdirk34": _esdirk34(),
    "kvaerno3": _from_diffrax(diffrax.Kvaerno3, 3),
    "kvaerno4": _from_diffrax(diffrax.Kvaerno4, 4),
    "kvaerno5": _from_diffrax(diffrax.Kvaerno5, 5),
}
