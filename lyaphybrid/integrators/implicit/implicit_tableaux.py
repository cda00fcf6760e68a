"""Coefficients of singly diagonally implicit methods with an explicit first stage.

ESDIRK34 of Jørgensen, Kristensen & Thomsen is determined by stage order 2, L-stability of its third-order weights and
order 4 of the others: γ is a root of 6γ³ − 18γ² + 9γ − 1. Advancing with the weights of order 4, as Linh et al. do,
gives up L-stability: |R(z)| grows like 0.31 |z|.

ESDIRK54b: the stages from the third on have order 3, the sixth is an L-stable method of order 4 with a62 = 0, the last
one a method of order 5 with b2 = 0 and Σ b_i a_i2 = 0. These conditions leave a few solutions for each γ. (With the
last stage L-stable instead of the sixth, and γ = 0.26, one of them is Kværnø's 5/4a, here "kvaerno5".) Table 4 of Linh
et al. shows which solution they used: once the motion has come to rest the error of an exponent is ln R(λh)/h − λ, and
the solution with γ = 0.27, advancing with the weights of order 5, has the errors printed there. These weights are
A-stable, with R(∞) = 0.873. Near λh = −1 both members of the pair have nearly the same error, and the error estimate
is far below it.
"""

import diffrax
import numpy as np

from ..runge_kutta import Tableau

__all__ = ["IMPLICIT"]


def _from_diffrax(solver: type, order: int) -> Tableau:
    table = solver.tableau
    return Tableau(
        table.a_lower,
        table.b_sol,
        tuple(map(float, table.c)),
        (table.b_error,),
        order,
        table.fsal,
        float(table.a_diagonal[-1]),
    )


def _esdirk34() -> Tableau:
    g = GAMMA34
    third = (0.102399400619911, -0.3768784522555561, 0.8386125301271861, g)
    fourth = np.array([0.15702489786032495, 0.11733044137043885, 0.6166780303921214, 0.10896663037711475])
    rows = ((g,), (0.1407377747247062, -0.1083655513813208), third[:3])
    return Tableau(rows, fourth, (2 * g, 0.4682387448518444, 1.0), (fourth - third,), 4, False, g)


def _esdirk54b() -> Tableau:
    rows = (
        (0.27,),
        (0.135, 0.87265371804359687),
        (0.24814211234447322, 0.1328208852285932, -0.038866866589177719),
        (0.25494479822150471, 0.13106196422347201, -0.045220939302357088, 0.033891216820516425),
        (0.17549975523182941, 0.0, -0.01641725931492384, 3.5935717529001063, -3.0226542488170118),
        (0.1584761264367041, 0.0, -0.073847037320949836, 5.2605677639763489, -4.839469477584075, 0.22427262449197180),
    )
    fifth = np.array([*rows[-1], 0.27])
    times = (0.54, 1.2776537180435969, 0.61209613098388873, 0.64467703996313606, 1.0, 1.0)
    return Tableau(rows, fifth, times, (fifth - [*rows[-2], 0.27, 0.0],), 5, True, 0.27)


GAMMA34 = 0.435866521508459
IMPLICIT = {
    "esdirk34": _esdirk34(),
    "esdirk54b": _esdirk54b(),
    "kvaerno3": _from_diffrax(diffrax.Kvaerno3, 3),
    "kvaerno4": _from_diffrax(diffrax.Kvaerno4, 4),
    "kvaerno5": _from_diffrax(diffrax.Kvaerno5, 5),
}
