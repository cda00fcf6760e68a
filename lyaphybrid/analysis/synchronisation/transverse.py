"""Conditional and transverse exponents: of a driven part of a system, or across a subspace in which it moves."""

import functools
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arguments import Progress, Real, State, numbers, require, require_one_start, whole
from ..._jax.tracing import traced
from ..._keywords import explains_keywords
from ...engine import preparation
from ...integrators.base import Method
from ...results.spectrum import Spectrum
from ...statuses import nan_where
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from ..spectra import lyapunov_spectrum
from .checking import check_jumps
from .reductions import Across, Response
from .skew_products import Cocycle, GuardJump, frame_of, require_flow_or_map, skew_product, start_of

__all__ = ["transverse_spectrum"]

BESIDE = 0.1  # relative size of the displacements within the subspace at which invariance is checked
ONE_OF = (
    "Give one of response=…, the components that the others drive, and subspace=…, columns that span the subspace in "
    "which the motion stays; got response={!r} and subspace={!r}."
)
FEEDS_BACK = (
    "At t = {:.6g} the response decides when a jump happens that moves the drive: perturbations of the response would "
    "change the drive. Conditional exponents are of a response that the drive does not feel."
)
LEAVES_SUBSPACE = (
    "The motion does not stay in the subspace: {} takes it out, at the point {} by {:.3g}. For coupled systems that "
    "jump one by one see lh.master_stability."
)


@explains_keywords
def transverse_spectrum(
    system: Flow | Map | Hybrid,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    response: Sequence[int | str] | None = None,
    subspace: Float[Array, "n m"] | Sequence[Sequence[float]] | None = None,
    t0: Real = 0.0,
    transient: Real = 0.0,
    mode: str | int | None = None,
    k: int | None = None,
    method: Method | None = None,
    every: Any = None,
    blocks: int = 64,
    target_stderr: float | None = None,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> Spectrum:
    """Exponents of perturbations of a driven part of a system, or across a subspace in which the motion stays.

    With `response` x = (v, w) and the drive v goes on as it is: the exponents of δw' = ∂f_w/∂w δw are the *conditional*
    exponents, negative where the response forgets its start and copies of it synchronise (L. M. Pecora & T. L.
    Carroll). With `subspace`, spanned by (n, m) columns M, the motion is kept within M, and the exponents are those of
    perturbations modulo M: the *transverse* exponents, negative where neighbours of M approach it.

    Across jumps perturbations go by the saltation matrix, restricted likewise. The response may decide when a jump
    happens only if that jump does not move the drive.

    Args:
        system: an `lh.Flow`, `lh.Map` or `lh.Hybrid`.
        x0: start, (n,); with `subspace` it lies within.
        args: pytree of parameters.
        t1: length of the run after the transient (iterations for a map).
        response: indices or names of the components that are driven.
        subspace: (n, m) columns, 1 ≤ m < n, that span a subspace that field and resets do not leave.
        t0: as for `lh.lyapunov_spectrum`.
        transient: as for `lh.lyapunov_spectrum`.
        mode: as for `lh.lyapunov_spectrum`.
        k: number of exponents; None: all, as many as the response has components, or n − m.
        method: as for `lh.lyapunov_spectrum`.
        every: as for `lh.lyapunov_spectrum`.
        blocks: as for `lh.lyapunov_spectrum`.
        target_stderr: as for `lh.lyapunov_spectrum`.
        max_steps: as for `lh.lyapunov_spectrum`.
        progress: as for `lh.lyapunov_spectrum`.
        throw: as for `lh.lyapunov_spectrum`.

    Returns:
        A `Spectrum` of k exponents. Its x and frame are those of (x, ξ), ξ the perturbation, which is 0.

    Raises:
        ValueError: on arguments that do not fit; where the start, the field or a reset leaves the subspace; where a
            jump that the response decides moves the drive, or several jumps follow each other at one instant (the first
            jumps of each transition are looked at). Under a transformation, as in a sweep, such a jump ends the run as
            nonfinite instead, and a start or field that leaves the subspace has nan as exponents.
        RunFailedError: where the run failed and `throw`.

    Source:
        L. M. Pecora & T. L. Carroll, Phys. Rev. Lett. 64 (1990) 821, doi:10.1103/PhysRevLett.64.821.

    Example:
        >>> import lyaphybrid as lh
        >>> lorenz = lh.zoo.lorenz63()
        >>> driven = lh.transverse_spectrum(lorenz.system, lorenz.x0, lorenz.args, response=[1, 2], t1=200.0)
        >>> bool(driven.exponents[0] < 0)  # copies of (y, z), driven by x, synchronise
        True
    """
    require_flow_or_map("transverse_spectrum", system)
    require_one_start("transverse_spectrum", x0)
    require((response is None) != (subspace is None), ONE_OF.format(response, subspace))
    problem, x, t, mode = preparation.prepare(system, x0, args, t0, method, mode)
    n, own = x.shape[0], problem.args
    known, leaves = not traced((x, t, own)), False  # else jumps cannot be checked, as inside jit
    if response is not None:
        driven = Response(_indices(system, response, n), n)
        cocycle: Cocycle = driven
        check = functools.partial(_check_drive, driven, own)
    else:
        across = _across(subspace, x)
        leaves = _leaves_subspace(system, across, t, x, own, known)
        cocycle, check = across, functools.partial(_check_reset, across)
    if known:
        length = float(transient) + float(t1)
        check_jumps(system, x, own, check, length=length, t0=t0, mode=mode, method=method)
    size = cocycle.size
    if k is not None:
        whole("k", k, least=1)
    require(k is None or k <= size, f"k must be at most {size}, the number of these exponents; got {k}.")
    product = skew_product(system, cocycle, n, watched=not known)
    found = lyapunov_spectrum(
        product, start_of(x, size), args, t1=t1, t0=t0, transient=transient, mode=mode,
        frame=frame_of(n, size, k or size, x.dtype), method=method, every=every, blocks=blocks,
        target_stderr=target_stderr, max_steps=max_steps, progress=progress, throw=throw,
    )  # fmt: skip
    return found if known else nan_where(leaves, found, "exponents", "stderr", "finite_exponents")


def _indices(system: Flow | Map | Hybrid, response, n: int) -> tuple[int, ...]:
    """The indices of the response, ascending."""
    names = list(system.names or ())
    listed = isinstance(response, Sequence | np.ndarray) and not isinstance(response, str) and len(response) > 0
    require(listed, f"response must be a list of indices or names of components; got {response!r}.")
    found = [names.index(one) if isinstance(one, str) and one in names else one for one in response]
    good = all(isinstance(one, int | np.integer) and not isinstance(one, bool) and 0 <= one < n for one in found)
    good = good and len(set(found)) == len(found)
    known = f" or of the names {names}" if names else ""
    require(good, f"response must be of 0 … {n - 1}{known}, once each; got {response}.")
    require(len(found) < n, f"response must leave a drive; got all {n} components.")
    return tuple(sorted(int(one) for one in found))


def _across(subspace, x) -> Across:
    """The cocycle of perturbations modulo the subspace."""
    n, columns = x.shape[0], np.asarray(numbers("subspace", subspace), x.dtype)
    fits = columns.ndim == 2 and columns.shape[0] == n and 1 <= columns.shape[1] < n
    require(fits, f"subspace must have shape (n, m) = ({n}, m) with 1 ≤ m < n; got {columns.shape}.")
    m = columns.shape[1]
    full, r = np.linalg.qr(columns, mode="complete")
    sizes = np.abs(np.diag(r))
    require(float(sizes.min()) > 1e-10 * float(sizes.max()), "subspace must have linearly independent columns.")
    return Across(jnp.asarray(full[:, :m]), jnp.asarray(full[:, m:]))


def _leaves_subspace(system, across: Across, t, x, args, known: bool):
    """Whether the start, or a field or the rule near it, is not in the subspace; where that is known a ValueError."""
    leaves = off = across.off(x)
    if known:
        require(not off, f"x0 must lie in the subspace; got {np.asarray(x)}, {float(off):.3g} off.")
    size = 1 + jnp.max(jnp.abs(x))
    for nudge in np.random.default_rng(1).normal(size=(3, across.basis.shape[1])):
        point = x + BESIDE * size * (across.basis @ jnp.asarray(nudge, x.dtype))
        for what, value in _moved(system, t, point, args):
            off = across.off(value)
            leaves = jnp.maximum(leaves, off)
            if known:
                require(not off, LEAVES_SUBSPACE.format(what, np.asarray(point).round(4), float(off)))
    return leaves > 0


def _moved(system, t, x, args):
    """What moves x, in words, and its value."""
    if isinstance(system, Map):
        yield "the rule", system.rule(t, x, args)
    elif isinstance(system, Flow):
        yield "the field", system.field(t, x, args)
    else:
        for name, field in zip(system.mode_names, system.fields, strict=True):
            yield f"the field of mode {name!r}", field(t, x, args)
        for one in system.transitions:
            if one.is_clock and one.reset is not None:
                yield "the reset of a clock", one.reset(t, x, args)


def _check_reset(across: Across, jump: GuardJump, t, x, new, *which) -> None:
    """Raise a ValueError where a jump leaves the subspace."""
    del jump, which
    off = across.off(new)
    require(not off, LEAVES_SUBSPACE.format(f"the jump at t = {float(t):.6g}", np.asarray(x).round(4), float(off)))


def _check_drive(response: Response, args, jump: GuardJump, t, x, new, *which) -> None:
    """Raise a ValueError where a jump that the response decides moves the drive."""
    require(bool(response.allows(jump, t, x, new, args, *which)), FEEDS_BACK.format(float(t)))
