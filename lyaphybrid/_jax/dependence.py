"""On which entries of dx the results of a linear function can depend, whatever the state: read off its jaxpr.

Each value that is not fixed has costs. If it does not depend on dx: 0 where it can differ from zero, ∞ where it cannot.
If it does: the lowest index in dx on which an entry can depend, and minus the highest; ∞ where there is none. A sum has
the smaller cost of its terms, a product the sum of the costs of its factors.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array, Float

from .jaxprs import MOVING, applied, evaluated, inside, is_call

__all__ = ["reach"]

ENTRY_ROUNDED = 1e-13  # entries of a known matrix below this times the largest one are rounding
MOST_PRODUCTS = 10**8  # of a product of matrices that is looked at


class Costs(NamedTuple):
    """The costs of a value that is not fixed: one array, or two if the value depends on dx."""

    parts: tuple


class UnclearError(Exception):
    """A primitive without a rule acts on what depends on dx."""


def reach(
    function: Callable, state: tuple, lowest: Float[np.ndarray, " n"], highest: Float[np.ndarray, " n"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]] | None:
    """The lowest and the highest index on which each entry of a result can depend, at any state.

    Args:
        function: ``(*state, dx) -> (m,)``, linear in dx. What it closes over, traced or not, is fixed.
        state: arrays that can have any values.
        lowest: of the index on which each entry of dx depends; ∞: on none.
        highest: the same; −∞: on none.

    Returns:
        Two arrays, with ∞ and −∞ for an entry that depends on none; None where a primitive has no rule.
    """
    closed = jax.make_jaxpr(function)(*state, jnp.zeros(len(lowest)))
    inputs = [Costs((jnp.zeros(jnp.shape(one)),)) for one in state]
    try:
        (found,) = evaluated(closed, [*inputs, Costs((jnp.asarray(lowest), -jnp.asarray(highest)))], _cost_of_equation)
    except UnclearError:
        return None
    if not isinstance(found, Costs) or len(found.parts) == 1:
        none = jnp.full(jnp.shape(closed.out_avals[0]), jnp.inf)
        return none, -none
    return found.parts[0], -found.parts[1]


def _cost_of_equation(closed: ClosedJaxpr, eqn, operands: list) -> list:
    if not any(isinstance(one, Costs) for one in operands):
        return applied(closed, eqn, operands)
    name, of_dx = eqn.primitive.name, max(len(one.parts) for one in operands if isinstance(one, Costs)) == 2
    if is_call(eqn) or name in CALLED_INSIDE:
        return evaluated(inside(eqn)[0], operands, _cost_of_equation)
    if name == "cond":
        each = [evaluated(one, operands[1:], _cost_of_equation) for one in eqn.params["branches"]]
        return [_smallest(results) for results in zip(*each, strict=True)]
    rule = MOVED.get(name) or (_moved if name in MOVING else COST_RULES.get(name))
    indices, data = _divided(name, operands)
    if name == "dot_general":
        data = [one if isinstance(one, Costs) else _without_rounding(one) for one in data]
        if _products(eqn) > MOST_PRODUCTS:
            rule = None
    if rule is None and of_dx:
        raise UnclearError(name)
    if rule is None:
        return [Costs((jnp.zeros(out.aval.shape),)) for out in eqn.outvars]
    # The function is linear in dx: what is added to a part that depends on dx, and does not itself, is zero.
    lone = None if name in COSTS_ADDED else jnp.inf
    each_side = zip(*(_parts(one, 1 + of_dx, lone) for one in data), strict=True)
    sides = [rule(eqn, indices, *each) for each in each_side]
    spread = [[jnp.broadcast_to(one, out.aval.shape) for one, out in zip(side, eqn.outvars, strict=True)]
              for side in sides]  # fmt: skip
    return [Costs(parts) for parts in zip(*spread, strict=True)]


def _parts(value, count: int, lone: float | None = None) -> tuple:
    """The costs of a value, `count` of them: of a fixed one 0 where it is not zero; `lone` where it has too few."""
    parts = value.parts if isinstance(value, Costs) else (jnp.where(jnp.asarray(value) != 0, 0.0, jnp.inf),)
    if len(parts) < count and lone is not None:
        parts = (jnp.full_like(parts[0], lone),)
    return parts * (count // len(parts))


def _smallest(values) -> Any:
    """The smaller costs of several values."""
    count = max((len(one.parts) for one in values if isinstance(one, Costs)), default=1)
    each = zip(*(_parts(one, count, jnp.inf) for one in values), strict=True)
    return Costs(tuple(functools.reduce(jnp.minimum, parts) for parts in each))


def _divided(name: str, operands: list) -> tuple[list, list]:
    """The operands that are indices or conditions, and the others."""
    chosen = range(len(operands))[INDICES.get(name, slice(0, 0))]
    return operands[chosen.start : chosen.stop], [one for i, one in enumerate(operands) if i not in chosen]


def _without_rounding(matrix):
    matrix = jnp.asarray(matrix)
    size = jnp.abs(matrix)
    return jnp.where(size > ENTRY_ROUNDED * jnp.max(size, initial=0), matrix, jnp.zeros_like(matrix))


def _products(eqn) -> int:
    (contracted, _), (_, batched) = eqn.params["dimension_numbers"]
    left, right = (one.aval.shape for one in eqn.invars)
    shared = [left[i] for i in contracted] + [right[i] for i in batched]
    return int(np.prod([*left, *right], dtype=float) / np.prod(shared, dtype=float)) if 0 not in (*left, *right) else 0


def _moved(eqn, indices: list, *data) -> list:
    """A primitive that only moves entries, or by an index that is not known brings any of them."""
    if not any(isinstance(one, Costs) for one in indices):
        found = eqn.primitive.bind(*_in_place(eqn.primitive.name, indices, data), **eqn.params)
        return found if eqn.primitive.multiple_results else [found]
    if eqn.primitive.name == "select_n":
        return [functools.reduce(jnp.minimum, data)]
    *kept, moved = data
    return [jnp.minimum(kept[0] if kept else jnp.inf, jnp.min(moved, initial=jnp.inf))]


def _in_place(name: str, indices: list, data: tuple) -> list:
    """The operands in their order."""
    first = INDICES[name].start if indices else 0
    return [*data[:first], *indices, *data[first:]]


def _scattered(eqn, indices: list, into, new) -> list:
    """A sum into entries at fixed indices, or at any."""
    if isinstance(indices[0], Costs):
        return [jnp.minimum(into, jnp.min(new, initial=jnp.inf))]
    options = {name: eqn.params[name] for name in ("indices_are_sorted", "unique_indices", "mode")}
    return [lax.scatter_min(into, indices[0], new, eqn.params["dimension_numbers"], **options)]


def _dot_of_costs(eqn, _, left, right) -> list:
    (own, theirs), (batch, batched) = eqn.params["dimension_numbers"]
    sides = []
    for one, contracted, shared in ((left, own, batch), (right, theirs, batched)):
        free = [i for i in range(one.ndim) if i not in (*contracted, *shared)]
        sizes = [[one.shape[i] for i in axes] for axes in (shared, free, contracted)]
        flat = [int(np.prod(size)) for size in sizes]
        sides.append((jnp.transpose(one, (*shared, *free, *contracted)).reshape(flat), sizes))
    (left, (batch, rows, _)), (right, (_, columns, _)) = sides
    found = jnp.min(left[:, :, None] + right[:, None], axis=-1, initial=jnp.inf)
    return [found.reshape(*batch, *rows, *columns)]


def _least(eqn, _, one) -> list:
    return [jnp.min(one, axis=eqn.params["axes"], initial=jnp.inf)]


COSTS_ADDED = ("div", "dot_general", "mul")
CALLED_INSIDE = ("closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat", "remat2")
INDICES: dict[str, slice] = {  # the operands that are indices or conditions
    "gather": slice(1, 2),
    "dynamic_slice": slice(1, None),
    "dynamic_update_slice": slice(2, None),
    "select_n": slice(0, 1),
} | dict.fromkeys(("scatter", "scatter-add", "scatter_add"), slice(1, 2))
# Rules (equation, indices, costs …) -> costs: of primitives that move entries but are not applied to costs …
MOVED: dict[str, Callable] = {"convert_element_type": lambda eqn, _, one: [one]}
# … and of others: zero at zero, sums, products.
AT_ZERO = (
    "abs", "asin", "asinh", "atan", "atanh", "cbrt", "copy", "erf", "expm1", "floor", "log1p", "neg", "real",
    "reduce_precision", "round", "sign", "sin", "sinh", "sqrt", "square", "tan", "tanh",
)  # fmt: skip
COST_RULES: dict[str, Callable] = dict.fromkeys(AT_ZERO, lambda eqn, _, one: [one]) | {
    "div": lambda eqn, _, above, below: [above],
    "dot_general": _dot_of_costs,
    "integer_pow": lambda eqn, _, one: [one if eqn.params["y"] > 0 else jnp.zeros_like(one)],
    "mul": lambda eqn, _, left, right: [left + right],
}
COST_RULES |= dict.fromkeys(("add", "add_any", "max", "min", "sub"), lambda eqn, _, *terms: [jnp.minimum(*terms)])
COST_RULES |= dict.fromkeys(("reduce_sum", "reduce_max", "reduce_min"), _least)
COST_RULES |= dict.fromkeys(("scatter-add", "scatter_add"), _scattered)
