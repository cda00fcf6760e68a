"""What differential–algebraic equations have fixed, along the motion."""

from typing import Any

import numpy as np

from ...systems.consistency import check_fixed_parts
from ...systems.daes.implicit_fields import ImplicitField
from ...systems.daes.semi_linear import Banded, fields_of
from .functions import Visited
from .report import Finding, right, wrong

__all__ = ["check_what_is_fixed"]

PLACES = 20  # states at which each mode is looked at


def check_what_is_fixed(system: Any, args: Any, along: Visited) -> list[Finding]:
    """Whether bands, and the kernel of ∂F/∂x' of implicit equations, stay what they were at states of the run."""
    modes = [q for q, field in enumerate(fields_of(system)) if isinstance(field, Banded | ImplicitField)]
    for q in modes:
        for t, x in zip(*along.of(q, PLACES), strict=True):
            try:
                check_fixed_parts(system, q, np.asarray(x), np.asarray(t), args)
            except ValueError as error:
                return [wrong("constraints", f"At t = {float(t):.6g} of the trial run: {error}")]
    said = "bands, and the kernel of ∂F/∂x' of implicit equations, are along the trial run what they were"
    return [right("constraints", said)] if modes else []
