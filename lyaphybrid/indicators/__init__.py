"""Indicators of chaos: what deviation vectors do, read off the orthonormalisations of the one propagation."""

from .alignment import Alignment, gali, sali
from .covariant import CovariantVectors, covariant_vectors
from .growth import Growth, fli, megno, ofli
from .verdicts import Verdict

__all__ = [
    "Alignment",
    "CovariantVectors",
    "Growth",
    "Verdict",
    "covariant_vectors",
    "fli",
    "gali",
    "megno",
    "ofli",
    "sali",
]
