"""Coefficients of symplectic schemes for H = A + B, with order and source of each.

A scheme is a product of flows of A (for H = T(p) + V(q): drifts, q += a h ∇T) and of B (kicks, p −= b h ∇V), read from
left to right. All are symmetric, so half of the coefficients determines a scheme.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

__all__ = ["COMPOSITIONS", "SCHEMES", "Scheme", "composed"]

PART_A, PART_B = 0, 1


class Scheme(NamedTuple):
    """A symmetric splitting scheme of H = A + B."""

    parts: tuple[tuple[int, float], ...]  # (A or B, fraction of the step), in the order in which they act
    order: int
    source: str
    corrector: float = 0.0  # g of exp(-(g/2) h³ C) before and after the step, C = {{A, B}, B}; 0: no corrector
    quadratic: bool = False  # only for a kinetic energy that is quadratic in p


def _alternating(first: int, *coefficients: float) -> tuple[tuple[int, float], ...]:
    """A and B alternately, beginning with `first`."""
    return tuple(((first + i) % 2, float(c)) for i, c in enumerate(coefficients))


def _mirrored(first: int, outer, inner) -> tuple[tuple[int, float], ...]:
    """The scheme that starts and ends with `first`, from the first half of both rows of coefficients.

    The middle of the scheme is the last number of `outer` if that row is longer, otherwise that of `inner`. None stands
    for the number with which the coefficients of its part sum to 1.
    """
    longer = len(outer) > len(inner)
    outer, inner = (_completed(row, middle) for row, middle in ((outer, longer), (inner, not longer)))
    row = [c for pair in zip(outer, inner, strict=False) for c in pair] + ([outer[-1]] if longer else [])
    return _alternating(first, *row, *row[-2::-1])


def _completed(row, middle: bool) -> list[float]:
    """The row with None replaced: that coefficient occurs once if it is the middle of the scheme, otherwise twice."""
    known = [c for c in row if c is not None]
    return list(row) if None not in row else [*known, 1 - 2 * sum(known) if middle else 0.5 - sum(known)]


def composed(weights: Sequence[float], parts: int = 2) -> tuple[tuple[int, float], ...]:
    """Leapfrogs over fractions w₁ … w_m … w₁ of the step; where two of them meet, their equal moves are merged.

    A leapfrog of the parts 0, 1, …, last: half a move of each part but the last, a whole move of the last, then the
    half moves again in the opposite order.
    """
    merged: list[tuple[int, float]] = []
    for weight in (*weights, *weights[-2::-1]):
        half = [(part, 0.5 * weight) for part in range(parts - 1)]
        for part, share in (*half, (parts - 1, weight), *reversed(half)):
            if merged and merged[-1][0] == part:
                share += merged.pop()[1]
            merged.append((part, share))
    return tuple(merged)


# SABAₙ and SBABₙ: kicks at the nodes of a quadrature rule, with its weights, and drifts from node to node.


def _quadrature_scheme(nodes, weights, first: int) -> tuple[tuple[int, float], ...]:
    """Kicks of the weights at the nodes in [0, 1], and drifts between them; with first = A also before and after."""
    if first == PART_A:
        drifts = np.diff([0.0, *nodes, 1.0])
        return _alternating(PART_A, *[c for pair in zip(drifts, weights, strict=False) for c in pair], drifts[-1])
    drifts = np.diff(nodes)
    return _alternating(PART_B, *[c for pair in zip(weights, drifts, strict=False) for c in pair], weights[-1])


def _corrector(nodes, weights) -> float:
    """Coefficient g = 1/12 − ¼ ΣΣ wᵢwⱼ|xᵢ − xⱼ| of the error term {{A, B}, B} h³; kicks of weights w at nodes x."""
    return float(1 / 12 - 0.25 * weights @ np.abs(nodes[:, None] - nodes[None, :]) @ weights)


def gauss_legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss's quadrature on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return 0.5 * (1 + nodes), 0.5 * weights


def gauss_lobatto(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Lobatto's quadrature with n ≥ 2 points on [0, 1], which include both ends."""
    legendre = np.polynomial.legendre.Legendre.basis(n - 1)
    inner = np.sort(np.real(legendre.deriv().roots())) if n > 2 else np.empty(0)
    nodes = np.concatenate([[-1.0], inner, [1.0]])
    return 0.5 * (1 + nodes), 1 / (n * (n - 1) * legendre(nodes) ** 2)


LASKAR_ROBUTEL = (
    "J. Laskar & P. Robutel, High order symplectic integrators for perturbed Hamiltonian systems, "
    "Celest. Mech. Dyn. Astron. 80 (2001) 39, doi:10.1023/A:1012098603882"
)
FARRES = (
    "A. Farrés, J. Laskar, S. Blanes, F. Casas, J. Makazaga & A. Murua, High precision symplectic integrators for the "
    "Solar System, Celest. Mech. Dyn. Astron. 116 (2013) 141, doi:10.1007/s10569-013-9479-6"
)
BLANES = (
    "S. Blanes, F. Casas, A. Farrés, J. Laskar, J. Makazaga & A. Murua, New families of symplectic splitting methods "
    "for numerical integration in dynamical astronomy, Appl. Numer. Math. 68 (2013) 58, "
    "doi:10.1016/j.apnum.2013.01.003"
)
BLANES_MOAN = (
    "S. Blanes & P. C. Moan, Practical symplectic partitioned Runge–Kutta and Runge–Kutta–Nyström methods, "
    "J. Comput. Appl. Math. 142 (2002) 313, doi:10.1016/S0377-0427(01)00492-7"
)
FOREST_RUTH = (
    "E. Forest & R. D. Ruth, Fourth-order symplectic integration, Physica D 43 (1990) 105, "
    "doi:10.1016/0167-2789(90)90019-L"
)
YOSHIDA = (
    "H. Yoshida, Construction of higher order symplectic integrators, Phys. Lett. A 150 (1990) 262, "
    "doi:10.1016/0375-9601(90)90092-3"
)
SUZUKI_UMENO = (
    "M. Suzuki & K. Umeno, in: Computer Simulation Studies in Condensed-Matter Physics VI (1993) 74, "
    "doi:10.1007/978-3-642-78448-4_7"
)
VERLET = "L. Verlet, Computer “experiments” on classical fluids, Phys. Rev. 159 (1967) 98, doi:10.1103/PhysRev.159.98"

# The rows below have the digits that the sources above print; for None see `_completed`.

_FOREST_RUTH = 1 / (2 - 2 ** (1 / 3))
_YOSHIDA6 = (0.784513610477557263819497633866, 0.235573213359358133684793182979, -1.177679984178871006946415680964)
_SUZUKI_UMENO8 = (
    0.74167036435061295344822780, -0.40910082580003159399730010, 0.19075471029623837995387626,
    -0.57386247111608226665638773, 0.29906418130365592384446354, 0.33462491824529818378495798,
    0.31529309239676659663205666,
)  # fmt: skip
_ABA864 = (
    (0.0711334264982231177779387300061549964174, 0.241153427956640098736487795326289649618,
     0.521411761772814789212136078067994229991, -0.333698616227678005726562603400438876027),
    (0.183083687472197221961703757166430291072, 0.310782859898574869507522291054262796375,
     -0.0265646185119588006972121379164987592663, 0.0653961422823734184559721793911134363710),
)  # fmt: skip
_ABA1064 = (
    (0.03809449742241219545697532230863756534060, 0.1452987161169137492940200726606637497442,
     0.2076276957255412507162056113249882065158, 0.4359097036515261592231548624010651844006,
     -0.6538612258327867093807117373907094120024),
    (0.09585888083707521061077150377145884776921, 0.2044461531429987806805077839164344779763,
     0.2170703479789911017143385924306336714532, -0.01737538195906509300561788011852699719871),
)  # fmt: skip
_BM4 = (
    (0.0792036964311957, 0.353172906049774, -0.0420650803577195, None),
    (0.209515106613362, -0.143851773179818, None),
)
_BM6 = (
    (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780, None),
    (0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175, None),
)
_SRKN11B = (
    (0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807, -0.0115113874206879, None),
    (0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928, None),
)
_SRKN14A = (
    (0.0378593198406116, 0.102635633102435, -0.0258678882665587, 0.314241403071447, -0.130144459517415,
     0.106417700369543, -0.00879424312851058, None),
    (0.09171915262446165, 0.183983170005006, -0.05653436583288827, 0.004914688774712854, 0.143761127168358,
     0.328567693746804, None),
)  # fmt: skip


COMPOSITIONS = {  # of leapfrogs with any number of parts: the first half of the weights, up to the middle one
    "leapfrog": (1.0,),
    "ForestRuth": (_FOREST_RUTH, 1 - 2 * _FOREST_RUTH),
    "Yoshida6": (*_YOSHIDA6, 1 - 2 * sum(_YOSHIDA6)),
    "SuzukiUmeno8": (*_SUZUKI_UMENO8, 1 - 2 * sum(_SUZUKI_UMENO8)),
}


def _table() -> dict[str, Scheme]:
    schemes = {"leapfrog": Scheme(composed(COMPOSITIONS["leapfrog"]), 2, VERLET)}
    for n in range(1, 11):
        for name, first, (nodes, weights) in (
            (f"SABA{n}", PART_A, gauss_legendre(n)),
            (f"SBAB{n}", PART_B, gauss_lobatto(n + 1)),
        ):
            parts = _quadrature_scheme(nodes, weights, first)
            schemes[name] = Scheme(parts, 2, LASKAR_ROBUTEL)
            schemes[f"{name}C"] = Scheme(parts, 4 if n > 1 else 2, LASKAR_ROBUTEL, _corrector(nodes, weights), True)
    return schemes | {
        "ForestRuth": Scheme(composed(COMPOSITIONS["ForestRuth"]), 4, FOREST_RUTH),
        "Yoshida6": Scheme(composed(COMPOSITIONS["Yoshida6"]), 6, YOSHIDA),
        "SuzukiUmeno8": Scheme(composed(COMPOSITIONS["SuzukiUmeno8"]), 8, SUZUKI_UMENO),
        "ABA864": Scheme(_mirrored(PART_A, *_ABA864), 4, BLANES),
        "ABA1064": Scheme(_mirrored(PART_A, *_ABA1064), 4, BLANES),
        "BlanesMoan4": Scheme(_mirrored(PART_A, *_BM4), 4, BLANES_MOAN),
        "BlanesMoan6": Scheme(_mirrored(PART_A, *_BM6), 6, BLANES_MOAN),
        "SRKN11b": Scheme(_mirrored(PART_B, *_SRKN11B), 6, BLANES_MOAN, quadratic=True),
        "SRKN14a": Scheme(_mirrored(PART_A, *_SRKN14A), 6, BLANES_MOAN, quadratic=True),
    }


SCHEMES = _table()
