"""OFLI2: the growth of one deviation vector orthogonal to the flow, to second order."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import Frame, Progress, Real, State, flag, require
from ..._jax.tracing import as_jax, numpy_for, traced
from ..._linalg.frames import generic_frame
from ...engine import preparation
from ...integrators import TangentHamiltonian
from ...integrators.base import Method
from ...integrators.second_variations import SecondVariation, VariedField, highest_of, started
from ...systems.daes.semi_linear import DAE
from ...systems.kinds import unit_of
from ...systems.smooth import Flow
from ...systems.validation import check_functions
from .following import follow, unit_columns, verdict_of
from .growth import IndicatorResult

__all__ = ["ofli2"]


def ofli2(
    system: Flow,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    times: Any = "log",
    t0: Any = 0.0,
    frame: Frame = None,
    method: Method | None = None,
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> IndicatorResult:
    """The orthogonal fast Lyapunov indicator to second order, sup ln ‖(ξ + ½ δξ)⊥‖ over the steps up to t.

        ξ' = Df ξ,   δξ' = Df δξ + D²f(ξ, ξ),   ξ(t0) = ξ₀,   δξ(t0) = 0;   ⊥: the part across the flow

    ξ and δξ are the first and second derivative of the motion along ξ₀, computed by the method's own step. Chaos shows
    earlier in δξ than in ξ: δξ grows like a power of t in regular motion, and like 2λ₁t in chaos.

    Args:
        system: an `lh.Flow` or `lh.Hamiltonian`.
        x0: start, shape (n,); or (m, n) for m runs at once.
        args: pytree of parameters.
        t1: length of the run.
        times: times at which it is recorded: "log", an increasing array that ends at t1, or None for equal intervals.
        t0: time at the start.
        frame: (n, 1) direction ξ₀; None: that of the gradient of the energy, where the system has one, else a fixed
            unit vector across the flow.
        method: as for `lh.trajectory`, except `lh.ContinuousQR`.
        blocks: number of times, where `times` is "log" or None.
        max_steps: most attempts of a step.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed.

    Returns:
        An `IndicatorResult` with `.time`, `.values` (times,), `.status` and `.verdict`.

    Raises:
        ValueError: on arguments that do not fit; on another system than a smooth flow; on `lh.TangentHamiltonian`,
            whose tangent is not the derivative of its step.
        RunFailedError: where the run failed and `throw`.

    Source:
        R. Barrio, Chaos, Solitons & Fractals 25 (2005) 711, doi:10.1016/j.chaos.2004.11.092; Lect. Notes Phys. 915
        (2016) 55, doi:10.1007/978-3-662-48410-4_3.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> growth = lh.Flow(lambda t, x, args: jnp.stack([1 + 0 * x[0], x[1] + x[1] ** 2]))
        >>> found = lh.ofli2(growth, [0.0, 0.0], t1=500.0, frame=[[0.0], [1.0]])  # ξ = eᵗ, δξ = 2(eᵗ − 1)eᵗ
        >>> round(float(found.values[-1]), 6)
        1000.0
    """
    flag("throw", throw)
    smooth = isinstance(system, Flow) and not isinstance(system, DAE)
    require(smooth, f"ofli2 takes two derivatives of a flow: it needs an lh.Flow or lh.Hamiltonian; got {system!r}.")
    good = not isinstance(method, TangentHamiltonian)
    require(good, "ofli2 differentiates the step itself, which lh.TangentHamiltonian does not: take lh.Symplectic.")
    preparation.grown_columns("ofli2", method)
    problem, x0, t0, _ = preparation.prepare(system, x0, args, t0, method, None)
    check_functions(system, jax.ShapeDtypeStruct(problem.shape, x0.dtype), problem.args)

    def start(x):
        f = system.field(t0, x, problem.args)
        return started(x, _direction(system, x, f, problem.args) if given is None else given, f)

    n = x0.shape[-1]
    given = None if frame is None else unit_columns(frame, n, 1, x0.dtype)[:, 0]
    varied = jax.vmap(start)(x0) if x0.ndim == 2 else start(x0)
    moving = traced(varied) or bool(np.all(np.isfinite(varied)))
    require(
        moving, f"The field and its derivative must be finite at x0, for these args; got {varied} and args {args!r}."
    )
    found = follow(
        None, _highest, Flow(VariedField(system.field)), varied, args, k=0,
        t1=t1, t0=t0, transient=0.0, times=times, blocks=blocks, mode=None, frame=None,
        method=SecondVariation(problem.method), max_steps=max_steps, progress=progress,
    )  # fmt: skip
    xp = numpy_for(found.time, found.collected, found.status)
    time, status = xp.asarray(found.time), xp.asarray(found.status)
    values = xp.where(xp.isnan(time), xp.nan, found.collected)
    return verdict_of(found, as_jax(IndicatorResult(time, values, None, status, "OFLI2", unit_of(system))), throw)


def _highest(t, carry):
    del t
    return highest_of(carry.x)


def _direction(system: Flow, x, f, args):
    """The unit vector along the gradient of the energy; of a flow without one a unit vector across the flow."""
    energy = getattr(system, "energy", None)
    if energy is not None:
        vector = jax.grad(energy)(x, args)
    else:
        vector, square = jnp.asarray(generic_frame(x.shape[0], 1, x.dtype)[:, 0]), jnp.sum(f**2)
        vector = vector - f * (jnp.sum(vector * f) / jnp.where(square > 0, square, 1.0))
    length = jnp.sqrt(jnp.sum(vector**2))
    return vector / jnp.where(length > 0, length, 1.0)
