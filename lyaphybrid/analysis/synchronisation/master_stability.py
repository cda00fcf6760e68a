"""The master stability function: exponents across the common motion of identical systems, coupled, for any network."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Progress, Real, State, flag, require, require_one_start, whole
from ..._jax.tracing import traced
from ..._keywords import explains_keywords
from ..._text import Table, with_error
from ...engine import preparation
from ...engine.host.lanes import map_lanes
from ...errors import RunFailedError
from ...integrators.base import Method
from ...results.result import Data, RunResult, exponents_along
from ...statuses import STATUS, verdicts
from ...systems.bound import require_callable
from ...systems.hybrid import Hybrid
from ...systems.kinds import unit_of
from ...systems.labels import unlabelled
from ...systems.smooth import Flow, Map
from ..spectra import lyapunov_spectrum
from .checking import check_jumps, differ
from .couplings import CoupledMode, order_of_jumps
from .skew_products import GuardJump, frame_of, require_flow_or_map, skew_product, start_of

__all__ = ["MasterStability", "master_stability"]

STRENGTHS_SHOWN = 12  # rows of a table
JUMPS = (
    "At t = {:.6g} the coupling's output jumps, from {} to {}. Systems that have jumped then act on those that have "
    "not, and what neighbours of the common motion do depends on their order: no linear rule tells it. Couple through "
    "what is continuous at jumps."
)
READS = (
    "At t = {:.6g} a guard or its reset depends on the input of the coupling, whose rate jumps there, from {} to {}: "
    "what neighbours of the common motion do depends on their order, and no linear rule tells it. Fields, and the "
    "resets of clocks, may depend on the input."
)
BOUND = (
    "In mode {!r} the motion is bound to a surface, which an input that is added to the field would leave. Give "
    "enters=…, which puts the input into args, and let the fields on both sides read it there."
)


class MasterStability(RunResult, eqx.Module):
    """Exponents across the common motion of coupled systems, as a function of α = strength × eigenvalue.

    Attributes:
        at: (m,) α, real or complex.
        exponents: (m, k), the largest first; stderr: (m, k) one standard error.
        largest: (m,) the largest of each.
        stable: (m,) whether it is negative: neighbours synchronise along modes with this α.
        critical: real α at which the largest exponent changes its sign, by linear interpolation; none of complex α.
        status: the gravest of the statuses of the runs, an `lh.STATUS`.

    Example:
        >>> import numpy as np, lyaphybrid as lh
        >>> found = lh.MasterStability(
        ...     np.array([-2.0, -1.0]), np.array([[-0.5], [0.5]]), np.zeros((2, 1)), np.zeros(2, int), "unit of time"
        ... )
        >>> found.stable.tolist(), found.critical.tolist()
        ([True, False], [-1.5])
    """

    at: np.ndarray
    exponents: Array | np.ndarray
    stderr: Array | np.ndarray
    status_code: Array | np.ndarray
    unit: str = eqx.field(static=True)

    @property
    def largest(self) -> Array | np.ndarray:
        """(m,) the largest exponents."""
        return self.exponents[:, 0]

    @property
    def stable(self) -> Array | np.ndarray:
        """(m,) whether the largest exponent is negative."""
        return self.largest < 0

    @property
    def critical(self) -> np.ndarray:
        """Real α at which the largest exponent changes its sign."""
        if np.iscomplexobj(self.at):
            return np.zeros(0)
        order = np.argsort(self.at)
        at, values = np.asarray(self.at)[order], np.asarray(self.largest)[order]
        first = np.flatnonzero(np.isfinite(values[:-1]) & np.isfinite(values[1:]) & (values[:-1] * values[1:] < 0))
        part = values[first] / (values[first] - values[first + 1])
        return at[first] + part * (at[first + 1] - at[first])

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The largest exponent against α, with its errors; of complex α the plane. `style` goes to what it draws."""
        return plots.master_stability(self, ax, **style)

    def _table(self) -> Table:
        at, k = np.asarray(self.at), self.exponents.shape[1]
        chosen = np.unique(np.linspace(0, len(at) - 1, STRENGTHS_SHOWN).astype(int))
        values, errors = np.asarray(self.exponents), np.asarray(self.stderr)
        rows = [(f"{at[i]:.6g}", *map(with_error, values[i], errors[i])) for i in chosen]
        notes = [f"stable at {int(np.sum(self.stable))} of {len(at)}", f"status {self.status}"]
        heads = ("α", *(f"λ{i + 1}" for i in range(k)))
        return Table(f"Master stability function per {self.unit}", rows, notes, heads)

    def _data(self) -> Data:
        per, dimensions = {"units": f"1/{self.unit}"}, ("at", "exponent")
        variables = {
            "exponents": (dimensions, self.exponents, per),
            "stderr": (dimensions, self.stderr, per),
            "stable": ("at", self.stable),
        }
        at = np.asarray(self.at)
        return Data(variables, {**exponents_along(self.exponents.shape[1]), "at": at})


class _OneStrength(eqx.Module):
    """The exponents of one α: (shared, (Re α, Im α)) -> (exponents (k,), stderr (k,), status)."""

    options: tuple[tuple[str, Any], ...] = eqx.field(static=True)  # of `lyapunov_spectrum`
    parts: int = eqx.field(static=True)

    def __call__(self, shared, strength):
        system, method, y, frame, args = shared
        found = lyapunov_spectrum(
            system, y, (args, strength), method=method, frame=frame, throw=False, **dict(self.options)
        )
        # A complex direction is a pair of real ones: their mean growth is that of the complex one.
        pairs = [jnp.mean(one.reshape(-1, self.parts), axis=1) for one in (found.exponents, found.stderr)]
        return *pairs, found.status_code


@explains_keywords
def master_stability(
    system: Flow | Map | Hybrid,
    coupling: Callable,
    x0: State,
    args: Any = None,
    *,
    at: Any,
    t1: Real,
    enters: Callable | None = None,
    t0: Real = 0.0,
    transient: Real = 0.0,
    mode: str | int | None = None,
    k: int = 1,
    method: Method | None = None,
    every: Any = None,
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> MasterStability:
    """Exponents across the common motion of identical systems, for every network of them at once.

    N systems xᵢ' = f(xᵢ) + s Σⱼ Gᵢⱼ H(xⱼ) with rows of G that sum to 0 have the common motion of one system alone.
    Along an eigenvector of G with the eigenvalue γ, perturbations of it grow as ξ' = (Df + α DH) ξ with α = s γ, and by
    the saltation matrices of one system at jumps. The network synchronises where the largest exponent is negative at
    α = s γ for each eigenvalue but that of the common motion itself, 0. Every α costs a run of one system, whatever N.

    Of jumping systems that are coupled, some have jumped and some have not for a moment. Perturbations have a linear
    rule only if that does not matter: H is continuous at jumps, and so is its rate where a guard or its reset depends
    on the input. The first jumps of each transition are looked at, and refused where it is not so. Clocks tick for all
    at once: their resets may depend on the input.

    Args:
        system: of one node: an `lh.Flow`, `lh.Map` (x⁺ᵢ = f(xᵢ) + s Σⱼ Gᵢⱼ H(xⱼ)) or `lh.Hybrid`.
        coupling: H, ``(t, x, args) -> (m,)``, with m = n where it is added to the fields.
        x0: start of the common motion, (n,).
        args: pytree of parameters of a node.
        at: α, or an array of them, real or complex; ``strength * numpy.linalg.eigvals(G)`` for one network.
        t1: length of each run after the transient (iterations for a map).
        enters: ``(args, input) -> args`` puts the input of a node into its parameters, where fields, and resets of
            clocks, read it; None: the input is added to the fields.
        t0: as for `lh.lyapunov_spectrum`.
        transient: as for `lh.lyapunov_spectrum`.
        mode: as for `lh.lyapunov_spectrum`.
        k: number of exponents of each α, at most n.
        method: as for `lh.lyapunov_spectrum`.
        every: as for `lh.lyapunov_spectrum`.
        blocks: as for `lh.lyapunov_spectrum`.
        max_steps: as for `lh.lyapunov_spectrum`.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where a run failed; False returns the result with its statuses.

    Returns:
        A `MasterStability` with `.exponents` (m, k), `.stable` (m,), `.critical` and `.plot()`.

    Raises:
        ValueError: on arguments that do not fit; where the order of jumps matters (under a transformation, as in a
            sweep, the run of each α ends there as nonfinite instead); where `enters` is needed, as for the sliding
            modes of `lh.filippov`.
        RunFailedError: where a run failed and `throw`; it carries the result.

    Source:
        L. M. Pecora & T. L. Carroll, Phys. Rev. Lett. 80 (1998) 2109, doi:10.1103/PhysRevLett.80.2109; for systems with
        jumps S. Coombes & R. Thul, Eur. J. Appl. Math. 27 (2016) 904, doi:10.1017/S0956792516000115.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> rule = lambda n, x, r: r * x * (1 - x)
        >>> found = lh.master_stability(lh.Map(rule), rule, [0.3], 4.0, at=[-0.2, -0.8], t1=20_000)
        >>> found.stable.tolist()  # λ = ln 2 + ln|1 + α|
        [False, True]
    """
    require_flow_or_map("master_stability", system)
    require_callable("coupling", coupling, "(t, x, args) -> (m,)")
    if enters is not None:
        require_callable("enters", enters, "(args, input) -> args")
    require_one_start("master_stability", x0)
    flag("throw", throw)
    whole("k", k, least=1)
    problem, x, t, mode = preparation.prepare(system, x0, args, t0, method, mode)
    n, own = x.shape[0], problem.args
    require(k <= n, f"k must be at most n = {n}; got {k}.")
    at = _strengths(at)
    if enters is None and isinstance(system, Hybrid):
        bound = [name for name, one in zip(system.mode_names, system.tangent, strict=True) if one is not None]
        require(not bound, BOUND.format(*bound[:1] or [""]))
    _check_output(coupling, enters, t, x, own)
    known = not traced((x, t, own))
    if known:
        check, length = functools.partial(_check_order, coupling, enters, own), float(transient) + float(t1)
        check_jumps(system, x, own, check, length=length, t0=t0, mode=mode, method=method)
    parts = 2 if jnp.iscomplexobj(at) else 1
    cocycle = CoupledMode(coupling, enters, n, parts)
    options = {
        "t1": t1, "t0": t0, "transient": transient, "mode": mode, "every": every, "blocks": blocks,
        "max_steps": max_steps,
    }  # fmt: skip
    lane = _OneStrength(tuple(options.items()), parts)
    lifted = skew_product(unlabelled(system), cocycle, n, watched=not known)
    shared = lifted, method, start_of(x, cocycle.size), frame_of(n, cocycle.size, k, x.dtype, parts), own
    exponents, stderr, codes = _at_each(lane, shared, at, progress)
    found = MasterStability(at, exponents, stderr, codes, unit_of(system))
    status = found.status
    if throw and isinstance(status, STATUS) and status.failed:
        raise RunFailedError(status, f"{verdicts(codes)}. A run of one α says more: give at=[one number].", found)
    return found


def _at_each(lane: _OneStrength, shared, at, progress):
    """Exponents (m, k), their errors and the statuses (m,) at all α."""
    lanes = jnp if traced((at, shared)) else np
    pairs = lanes.stack([lanes.real(at), lanes.imag(at)], axis=1)
    if traced((pairs, shared)):
        return jax.vmap(lambda pair: lane(shared, pair))(pairs)
    (exponents, stderr, codes), done = map_lanes(lane, shared, pairs, progress=progress)
    missing = ~done[:, None]
    return (
        np.where(missing, np.nan, exponents),
        np.where(missing, np.nan, stderr),
        np.where(done, codes, np.int32(STATUS.interrupted)),
    )


def _strengths(at) -> Any:
    """α as an array (m,)."""
    if traced(at):
        return jnp.atleast_1d(jnp.asarray(at))
    given = np.atleast_1d(np.asarray(at))
    good = given.ndim == 1 and given.size and given.dtype.kind in "iufc" and np.all(np.isfinite(given))
    require(bool(good), f"at must be one or several finite numbers, real or complex, shape (m,); got {at!r}.")
    return given if given.dtype.kind == "c" else given.astype(float)


def _check_output(coupling, enters, t, x, args) -> None:
    """Raise a ValueError unless the coupling's output is an array that can be the input."""
    output = jax.eval_shape(coupling, t, x, args)
    require(isinstance(output, jax.ShapeDtypeStruct), f"coupling must return one array (m,); got {output}.")
    n = x.shape[0]
    fits = len(output.shape) == 1 and (enters is not None or output.shape == (n,))
    wanted = "(m,)" if enters is not None else f"({n},), as the field, to which it is added; or give enters=…"
    require(fits, f"coupling must return an array of shape {wanted}; got {output.shape}.")


def _check_order(coupling, enters, args, jump: GuardJump, t, x, new, *which) -> None:
    """Raise a ValueError where it matters which of two systems jumps first."""
    order = order_of_jumps(coupling, enters, args, jump, t, x, new, *which)
    before, after = np.asarray(order.before), np.asarray(order.after)
    require(not differ(before, after), JUMPS.format(float(t), before, after))
    require(not order.depends or not differ(*order.rates), READS.format(float(t), *map(np.asarray, order.rates)))
