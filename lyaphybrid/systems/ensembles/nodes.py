"""The functions of a network, from those of one node: fields, guards, resets, targets and projections.

Every function of a node sees the node's own state and, where `enters` is given, the node's input in its parameters.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..hybrid import Transition

__all__ = ["NodeWiring", "of_clock", "of_each", "of_group", "of_one", "of_start", "projected", "target_of"]

Nodes = tuple[int, ...]


class NodeWiring(eqx.Module):
    """How N nodes hear each other; the parameters of the network are (those of a node, strength).

    Attributes:
        coupling: H, ``(t, x, args) -> (m,)``.
        matrix: G, (N, N).
        enters: ``(args, input) -> args``; None: inputs are added to the fields.
    """

    coupling: Callable
    matrix: Float[Array, "N N"]
    enters: Callable | None

    @property
    def count(self) -> int:
        """N."""
        return self.matrix.shape[0]

    def nodes(self, x):
        """(N, n) the states of the nodes."""
        return x.reshape(self.count, -1)

    def inputs(self, t, x, args):
        """(N, m) what each node hears, strength Σⱼ Gᵢⱼ H(xⱼ)."""
        own, strength = args
        outputs = jax.vmap(lambda x: self.coupling(t, x, own))(self.nodes(x))
        # Differences, so that equal nodes do not act on each other, not even by rounding.
        differences = outputs[None, :, :] - outputs[:, None, :]
        return strength * jnp.sum(self.matrix[:, :, None] * differences, axis=1)

    def each(self, function: Callable, t, x, args, chosen: Nodes, *of_nodes):
        """(len(chosen), …) a node's function at some nodes; `of_nodes`: more arguments, (len(chosen), …)."""
        where = slice(None) if chosen == tuple(range(self.count)) else np.array(chosen)
        own, nodes = args[0], self.nodes(x)[where]
        enters = self.enters
        if enters is None:
            return jax.vmap(lambda x, *more: function(t, x, own, *more))(nodes, *of_nodes)
        inputs = self.inputs(t, x, args)[where]
        return jax.vmap(lambda x, c, *more: function(t, x, enters(own, c), *more))(nodes, inputs, *of_nodes)

    def at(self, function: Callable, t, x, args, node, *which):
        """A node's function at one node, a traced index."""
        own, here = args[0], self.nodes(x)[node]
        if self.enters is not None:
            own = self.enters(own, self.inputs(t, x, args)[node])
        return function(t, here, own, *which)

    def width(self, guard: Callable, t, x, args) -> tuple[int, ...]:
        """The shape of a node's guard: () or (m,)."""
        return jax.eval_shape(lambda t, x: self.at(guard, t, x, args, 0), t, x).shape


class _GroupOfNodes(eqx.Module):
    wiring: NodeWiring
    functions: tuple[Callable, ...]
    chosen: tuple[Nodes, ...] = eqx.field(static=True)
    adds: bool = eqx.field(static=True)

    def __call__(self, t, x, args):
        wiring = self.wiring
        moved = wiring.nodes(x)
        for function, chosen in zip(self.functions, self.chosen, strict=True):
            values = wiring.each(function, t, x, args, chosen)
            moved = values if len(chosen) == wiring.count else moved.at[np.array(chosen)].set(values)
        if self.adds and wiring.enters is None:
            moved = moved + wiring.inputs(t, x, args)
        return moved.reshape(-1)


def of_group(wiring: NodeWiring, groups: Sequence[tuple[Callable, Nodes]], *, adds: bool = False) -> Callable:
    """A field, the rule of a map or the reset of a clock; other nodes stay. `adds`: the inputs, where none enters."""
    functions, chosen = zip(*groups, strict=True)
    return _GroupOfNodes(wiring, functions, chosen, adds)


class _NodesProjected(eqx.Module):
    wiring: NodeWiring
    projections: tuple[Callable | None, ...]
    chosen: tuple[Nodes, ...] = eqx.field(static=True)

    def __call__(self, t, x, args, dx):
        rows = self.wiring.nodes(dx)
        for project, chosen in zip(self.projections, self.chosen, strict=True):
            if project is not None:
                where = np.array(chosen)
                rows = rows.at[where].set(self.wiring.each(project, t, x, args, chosen, rows[where]))
        return rows.reshape(-1)


def projected(wiring: NodeWiring, groups: Sequence[tuple[Callable | None, Nodes]]) -> Callable:
    """The projection onto the tangent space of a combination of modes."""
    projections, chosen = zip(*groups, strict=True)
    return _NodesProjected(wiring, projections, chosen)


class _EachOfNodes(eqx.Module):
    wiring: NodeWiring
    function: Callable
    like: Callable | None
    chosen: Nodes = eqx.field(static=True)

    def __call__(self, t, x, args):
        values = self.wiring.each(self.function, t, x, args, self.chosen)
        if self.like is not None:  # one condition for all components of a guard
            shape = (len(self.chosen), *self.wiring.width(self.like, t, x, args))
            values = jnp.broadcast_to(values.reshape(values.shape + (1,) * (len(shape) - values.ndim)), shape)
        return values.reshape(-1)


def of_each(wiring: NodeWiring, function: Callable, chosen: Nodes, *, like: Callable | None = None) -> Callable:
    """A guard of some nodes, or the condition `when` of a guard like `like`: (len(chosen) m,)."""
    return _EachOfNodes(wiring, function, like, chosen)


class _OneOfNodes(eqx.Module):
    wiring: NodeWiring
    reset: Callable
    guard: Callable
    chosen: Nodes = eqx.field(static=True)

    def __call__(self, t, x, args, which):
        node, component = _fired(self.wiring, self.guard, self.chosen, t, x, args, which)
        new = self.wiring.at(self.reset, t, x, args, node, *component)
        return self.wiring.nodes(x).at[node].set(new).reshape(-1)


def _fired(wiring: NodeWiring, guard: Callable, chosen: Nodes, t, x, args, which):
    """The node whose guard fired, and the component of its guard where there are several."""
    shape = wiring.width(guard, t, x, args)
    place, component = (which // shape[0], (which % shape[0],)) if shape else (which, ())
    return jnp.asarray(np.array(chosen, np.int32))[place], component


def of_one(wiring: NodeWiring, reset: Callable, guard: Callable, chosen: Nodes) -> Callable:
    """The reset of the node whose guard fires; all others stay."""
    return _OneOfNodes(wiring, reset, guard, chosen)


class _CombinationAfter(eqx.Module):
    wiring: NodeWiring
    guard: Callable | None
    target: Callable | int
    modes: int = eqx.field(static=True)
    combination: tuple[int, ...] = eqx.field(static=True)
    chosen: Nodes = eqx.field(static=True)

    def __call__(self, t, x, args, *which):
        before, weights = np.array(self.combination, np.int32), _weights(self.wiring.count, self.modes)
        if self.guard is None:
            after = self._each(t, x, args)
            moved = jnp.sum((after - before[np.array(self.chosen)]) * weights[np.array(self.chosen)])
        else:
            node, component = _fired(self.wiring, self.guard, self.chosen, t, x, args, *which)
            after = self._at(t, x, args, node, *component)
            moved = (after - jnp.asarray(before)[node]) * jnp.asarray(weights)[node]
        return jnp.where(jnp.any(after < 0), -1, int(before @ weights) + moved)

    def _each(self, t, x, args):
        if not callable(self.target):
            return jnp.full(len(self.chosen), self.target, jnp.int32)
        return jnp.asarray(self.wiring.each(self.target, t, x, args, self.chosen), jnp.int32)

    def _at(self, t, x, args, node, *component):
        if not callable(self.target):
            return jnp.asarray(self.target, jnp.int32)
        return jnp.asarray(self.wiring.at(self.target, t, x, args, node, *component), jnp.int32)


def _weights(count: int, modes: int) -> np.ndarray:
    """(N,) by how much the index of a combination grows with the mode of each node."""
    return modes ** np.arange(count - 1, -1, -1, dtype=np.int32)


def target_of(
    wiring: NodeWiring, transition: Transition, target: Callable | int, modes: int, combination, chosen: Nodes
) -> Callable:
    """The index of the combination after a jump out of `combination`; negative where the node has no mode."""
    return _CombinationAfter(wiring, transition.guard, target, modes, tuple(combination), chosen)


class _CombinationAtStart(eqx.Module):
    wiring: NodeWiring
    initial_mode: Callable
    modes: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        count = self.wiring.count
        each = jnp.asarray(self.wiring.each(self.initial_mode, t, x, args, tuple(range(count))), jnp.int32)
        return jnp.where(jnp.any(each < 0), -1, jnp.sum(each * _weights(count, self.modes)))


def of_start(wiring: NodeWiring, initial_mode: Callable, modes: int) -> Callable:
    """The combination to which a start belongs."""
    return _CombinationAtStart(wiring, initial_mode, modes)


class _OfOneNode(eqx.Module):
    function: Callable

    def __call__(self, args):
        return self.function(args[0])


def of_clock(value: Any) -> Any:
    """The period or the phase of a clock, from the parameters of a node."""
    return _OfOneNode(value) if callable(value) else value
