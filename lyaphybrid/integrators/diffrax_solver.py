"""Any diffrax solver as a one-step method; implicit ones integrate stiff flows, also with events."""

import dataclasses
from typing import Any

import diffrax
import equinox as eqx
import jax.numpy as jnp

from .._arguments import is_one_of, positive
from .base import Field, Method, Step
from .divergences import trace

__all__ = ["ByDiffrax", "Diffrax", "with_tolerances"]

# Gauss–Legendre with four points on [0, 1]: order 8, above that of any diffrax solver's dense output.
_NODES = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263)
_WEIGHTS = (0.17392742256872692, 0.32607257743127307, 0.32607257743127307, 0.17392742256872692)


class ByDiffrax(Method):
    """A method whose steps are those of a diffrax solver with an error estimate."""

    solver: eqx.AbstractVar[diffrax.AbstractSolver]

    @property
    def fixed_step(self) -> Any:
        """The fixed step; None where the error estimate controls h."""
        return None

    @property
    def error_order(self) -> int:
        """The order p of the error estimate: it falls as h^p."""
        return int(self.solver.order(diffrax.ODETerm(lambda t, y, args: y)) or 1)


class Diffrax(ByDiffrax):
    """A diffrax solver under our step-size control; guards are evaluated on diffrax's dense output.

    Args:
        solver: a diffrax solver with an embedded error estimate, for example ``diffrax.Kvaerno5()``.
        rtol: relative tolerance of the local error.
        atol: absolute tolerance of the local error, in units of x.

    Raises:
        ValueError: if ``solver`` is no diffrax solver with an error estimate; on tolerances that are not positive.

    Source:
        P. Kidger, On Neural Differential Equations, thesis (Oxford 2021), arXiv:2202.02435.

    Example:
        >>> import diffrax, lyaphybrid as lh
        >>> stiff = lh.Diffrax(diffrax.Kvaerno5(), rtol=1e-8, atol=1e-10)
    """

    solver: diffrax.AbstractSolver
    rtol: Any
    atol: Any
    control: str = eqx.field(static=True)

    def __init__(self, solver: diffrax.AbstractSolver, rtol: Any = 1e-9, atol: Any = 1e-12, control: str = "xY"):
        if not is_one_of(control, ("x", "xY")):
            raise ValueError(f"control must be 'xY' (state and frame) or 'x' (state alone); got {control!r}.")
        positive("rtol", rtol)
        positive("atol", atol)
        self.solver, self.rtol, self.atol, self.control = with_tolerances(solver, rtol, atol), rtol, atol, control

    def step(self, field: Field, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        del f  # diffrax computes its first stage itself
        term = diffrax.ODETerm(lambda t, y, args: field(t, y))
        state = self.solver.init(term, t, t + h, x, None)
        new, error, dense, _, result = self.solver.step(term, t, t + h, x, None, state, made_jump=False)
        # A failed root finder must reject the step: an infinite error estimate does.
        failed = result != diffrax.RESULTS.successful
        error = jnp.where(failed, jnp.inf, 0.0) + (jnp.zeros_like(x) if error is None else error)
        dense = t, h, dense
        return Step(new, field(t + h, new), error[None], dense, dense)

    def inside(self, dense, theta):
        """Diffrax's own dense output at the fraction theta of the step."""
        t, h, info = dense
        interpolation = self.solver.interpolation_cls(t0=t, t1=t + h, **info)
        return interpolation.evaluate(t + theta * h)

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt over the step by Gauss–Legendre on the dense output."""
        t, _, _ = nodes
        return h * sum(
            w * trace(field, t + node * h, self.inside(nodes, node)) for node, w in zip(_NODES, _WEIGHTS, strict=True)
        )


def with_tolerances(solver: diffrax.AbstractSolver, rtol, atol) -> diffrax.AbstractSolver:
    """The solver, changed so that it has forward-mode derivatives; a ValueError if it has no error estimate."""
    if not isinstance(solver, diffrax.AbstractAdaptiveSolver):
        made = f" Make one by brackets: diffrax.{solver.__name__}()." if isinstance(solver, type) else ""
        raise ValueError(
            f"solver must be a diffrax solver with an error estimate, such as diffrax.Kvaerno5(); got {solver!r}.{made}"
        )
    if isinstance(solver, diffrax.AbstractImplicitSolver):
        solver = _with_root_finder(solver, rtol, atol)
    if hasattr(solver, "scan_kind"):  # diffrax's own loop over the stages has no forward mode; lax.scan has
        solver = dataclasses.replace(solver, scan_kind="lax")  # pyright: ignore[reportCallIssue]
    return solver


def _with_root_finder(solver, rtol, atol):
    """The solver with a Newton iteration to 1/100 of the tolerances (VeryChord's kappa); tighter, it often fails."""
    finder = diffrax.VeryChord(rtol=rtol, atol=atol)
    return eqx.tree_at(lambda s: s.root_finder, solver, finder, is_leaf=lambda x: x is None)
