"""Conserved quantities such as energy or momentum; their value selects one orbit of a family."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...._arguments import require
from ...._jax.precision import digits
from ....systems.daes.semi_linear import fields_of
from ....systems.smooth import Map

__all__ = ["Conserved", "conserved_of", "energies_of", "require_conserved", "steepness_of"]

EQUAL_QUANTITIES = 1e-8  # relative tolerance for a rate of change, or a change at a jump, of a conserved quantity


class Conserved(NamedTuple):
    """Conserved functions and the values that they are to have."""

    functions: tuple[Callable | None, ...]  # (x (n,), args) -> number or (c,); one for each mode
    wanted: np.ndarray  # (c,)

    def value(self, mode: int, x, args) -> np.ndarray:
        """The values (c,) at a state."""
        return self.with_slopes(mode, x, args)[0]

    def with_slopes(self, mode: int, x, args) -> tuple[np.ndarray, np.ndarray]:
        """The values (c,) at a state, and their derivatives (c, n)."""
        values, slopes = _with_slopes(self.functions[mode], jnp.asarray(x), args)
        return np.asarray(values), np.asarray(slopes)

    def strayed(self, mode: int, x, args) -> tuple[np.ndarray, np.ndarray]:
        """Distances (c,) of the values from those wanted, as lengths in state space, and their derivatives (c, n)."""
        values, slopes = self.with_slopes(mode, x, args)
        steepness = steepness_of(slopes)
        return (values - self.wanted) / steepness, slopes / steepness[:, None]


def steepness_of(slopes: np.ndarray) -> np.ndarray:
    """The lengths (c,) of derivatives (c, n), by which values become distances; 1 for 0, at an equilibrium."""
    lengths = np.linalg.norm(slopes, axis=1)
    return np.where(lengths > 0, lengths, 1.0)


@eqx.filter_jit
def _with_slopes(function, x, args):
    def values(x):
        return jnp.atleast_1d(function(x, args))

    return values(x), jax.jacrev(values)(x)


def conserved_of(conserve: Any, system, x, mode: int, args) -> Conserved | None:
    """The quantities that the user wants conserved, with their values at x.

    Args:
        conserve: None; True, for the energy that the field comes from; ``(x, args) -> number or (c,)``; or one of these
            for each mode, by name.
        system: an `lh.Flow`, `lh.Hybrid` or `lh.Map`.
        x: (n,) a state.
        mode: index of the mode there.
        args: pytree of parameters.

    Raises:
        ValueError: on what cannot be evaluated at x. `require_conserved` checks whether it is conserved.
    """
    if conserve is None or conserve is False:
        return None
    functions = _functions(conserve, system)
    function = functions[mode]
    if function is None:
        raise ValueError(f"conserve must name the mode of x0, {system.mode_names[mode]!r}, too.")
    result = jax.eval_shape(function, x, args)
    good = hasattr(result, "dtype") and jnp.issubdtype(result.dtype, jnp.floating) and result.ndim < 2 and result.size
    require(bool(good), f"conserve: the function must return a number, or several (c,), as floats; got {result}.")
    unset = Conserved(functions, np.zeros(0))
    wanted, slopes = unset.with_slopes(mode, x, args)
    known = bool(np.all(np.isfinite(wanted)) and np.all(np.isfinite(slopes)))
    require(known, f"conserve: the value and its derivatives must be finite at x0; got {wanted} and {slopes}.")
    require(
        bool(np.all(np.any(slopes, axis=1))),
        f"conserve: the derivative is 0 at x0 = {x}: it does not depend on the state, or x0 is an equilibrium.",
    )
    return unset._replace(wanted=wanted)


def energies_of(system) -> tuple[Callable | None, ...]:
    """The energy of each mode's field; None where it is not known."""
    return tuple(getattr(field, "energy", None) for field in fields_of(system))


def _functions(conserve: Any, system) -> tuple[Callable | None, ...]:
    """One function for each mode; None in modes that the user leaves out."""
    names = getattr(system, "mode_names", ("flow",))
    if conserve is True:
        energies = energies_of(system)
        require(
            bool(energies) and None not in energies,
            "conserve=True needs an lh.Hamiltonian, an lh.canonical_flow or an lh.Hybrid of them, whose energy is "
            "known; give conserve=(x, args) -> number.",
        )
        return energies
    if isinstance(conserve, Mapping):
        unknown = [name for name in conserve if name not in names]
        require(not unknown, f"conserve names unknown modes {unknown}; the modes are {list(names)}.")
        given = tuple(conserve.get(name) for name in names)
    else:
        given = (conserve,) * len(names)
    require(
        all(function is None or callable(function) for function in given) and any(given),
        f"conserve must be True, a function (x, args) -> number or (c,), or such functions by mode; got {conserve!r}.",
    )
    return given


def require_conserved(flow: Any, piece: Any) -> None:
    """Raise a ValueError unless the values are conserved along a piece of motion, through its jumps.

    Fields and resets are checked at states on the way; integration errors play no part.
    """
    conserved, args, system = flow.conserved, flow.problem.args, flow.problem.system
    names = getattr(system, "mode_names", ("flow",))
    gone = [names[mode] for mode in np.unique(piece.modes) if conserved.functions[int(mode)] is None]
    require(not gone, f"conserve must name all modes that the orbit visits; missing: {gone}.")
    if isinstance(system, Map):
        states = [piece.start.x, *piece.points]
        for before, after in zip(states[:-1], states[1:], strict=True):
            _require_kept(conserved, args, (0, before), (0, after), "an iteration")
        return
    for i in np.linspace(0, len(piece.times) - 1, 16).astype(int):
        t, x = piece.start.t + piece.times[i], jnp.asarray(piece.points[i])
        node = piece.start._replace(t=t, x=x, mode=int(piece.modes[i]))
        _, slopes = conserved.with_slopes(node.mode, node.x, args)
        velocity = flow.velocity(node)
        rates, terms = slopes @ velocity, np.abs(slopes) @ np.abs(velocity)
        require(
            not np.any(np.abs(rates) > digits(EQUAL_QUANTITIES, node.x) * terms),
            f"conserve must be a quantity that the motion conserves; got one that changes at the rate {rates} at x = "
            f"{node.x} in mode {names[node.mode]!r}, of terms as large as {terms}. Likely causes: (a) friction or "
            "driving; (b) the energy of another mode, give a function for each; (c) a factor, a mass or a sign.",
        )
    columns = ("transition", "x_before", "mode_before", "x_after", "mode_after")
    events = () if piece.events is None else zip(*(getattr(piece.events, name) for name in columns), strict=True)
    for j, x_before, mode_before, x_after, mode_after in events:
        before, after = (int(mode_before), x_before), (int(mode_after), x_after)
        _require_kept(conserved, args, before, after, f"the jump of transition {int(j)}")


def _require_kept(conserved: Conserved, args, before: tuple, after: tuple, how: str) -> None:
    """Require the same values at two (mode, state), up to the rounding of their terms."""
    (first, first_slopes), (then, then_slopes) = (conserved.with_slopes(mode, x, args) for mode, x in (before, after))
    terms = np.abs(first_slopes) @ np.abs(before[1]) + np.abs(then_slopes) @ np.abs(after[1])
    rounding = digits(EQUAL_QUANTITIES, np.asarray(before[1])) * (np.abs(first) + np.abs(then) + terms)
    require(
        not np.any(np.abs(then - first) > rounding),
        f"conserve must be a quantity that the motion conserves; got one that is changed by {how} from x = "
        f"{before[1]}: {first} -> {then}. Likely causes: (a) an impact that loses energy; (b) the energy of another "
        "mode, give a function for each.",
    )
