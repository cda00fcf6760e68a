"""Indicators of chaos: computed from the orthonormalisations of deviation vectors in the one loop."""

from .alignment import GALIResult, gali, sali
from .covariant import CovariantVectors, covariant_vectors
from .exponent_bounds import ExponentBounds, exponent_bounds
from .growth import IndicatorResult, fli, megno, ofli
from .intervals import SpectralIntervals, spectral_intervals
from .second_order import ofli2
from .svd_spectra import SVDSpectrum, svd_spectrum
from .verdicts import Verdict

__all__ = [
    "GALIResult",
    "CovariantVectors",
    "ExponentBounds",
    "IndicatorResult",
    "SVDSpectrum",
    "SpectralIntervals",
    "Verdict",
    "covariant_vectors",
    "exponent_bounds",
    "fli",
    "gali",
    "megno",
    "ofli",
    "ofli2",
    "sali",
    "spectral_intervals",
    "svd_spectrum",
]
