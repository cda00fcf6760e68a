"""Networks: N identical systems with diffusive coupling as one system."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..._arguments import numbers, require
from ..bound import require_callable
from ..daes.semi_linear import Constrained
from ..event_driven import EventDriven
from ..hybrid import Hybrid, Transition
from ..smooth import Flow, Map
from .nodes import NodeWiring, of_clock, of_each, of_group, of_one, of_start, projected, target_of

__all__ = ["coupled_network"]

ROW_SUM = 1e-12  # relative: sums of rows below this are rounding
COMBINATIONS = 32  # of modes: each is compiled by itself, in a second or two
TOO_MANY_MODES = (
    "coupled_network makes a mode of each combination of the modes of its nodes: {} nodes with {} modes have {}, and "
    "at most {} are compiled. lh.master_stability tells of any network of them."
)
CLOCK_OF_NODES = (
    "coupled_network takes clocks that change no mode, or that lead from the modes of their source=… to a target "
    "outside them, so that no node is armed again at the same tick."
)
BOUND_NODES = (
    "In the modes {} a node is bound to a surface, which an input that is added to its field would leave. Give "
    "enters=…, which puts the input into args, and let the fields on both sides read it there."
)


def coupled_network(
    node: Flow | Map | Hybrid, coupling: Callable, matrix: Any, *, enters: Callable | None = None
) -> Flow | Map | Hybrid:
    """N identical systems xᵢ' = f(xᵢ) + strength Σⱼ Gᵢⱼ H(xⱼ) as one system, whose rows of G sum to 0.

    Its state is x₁, …, x_N one after the other, (N n,), and its args are the pair (args of a node, strength). Equal
    nodes stay equal to the last bit, nodes with several modes within rounding. A step costs in proportion to N².

    A node with M modes, such as that of `lh.filippov`, makes a network with the Mᴺ combinations of them, "plus,sliding"
    for one: N blocks that rub, coupled by springs, and each of them slides or sticks by itself.

    Args:
        node: an `lh.Flow`, `lh.Map` or `lh.Hybrid`.
        coupling: H, ``(t, x, args) -> (m,)``, with m = n where it is added to the fields.
        matrix: G, (N, N), such as minus the Laplacian of a graph.
        enters: as for `lh.master_stability`; all functions of a node find the input in their args, but the surface of
            an `lh.filippov` must not depend on it.

    Returns:
        An `lh.Flow`, `lh.Map` or `lh.Hybrid`.

    Raises:
        ValueError: on arguments that do not fit; on rows that do not sum to 0; on more combinations of modes than can
            be compiled; without `enters` where a mode is bound to a surface, which an added input would leave.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> decay = lh.Flow(lambda t, x, a: -a * x)
        >>> pair = lh.coupled_network(decay, lambda t, x, a: x, [[-1.0, 1.0], [1.0, -1.0]])
        >>> s = lh.lyapunov_spectrum(pair, [1.0, 2.0], (1.0, 0.5), t1=20.0, transient=20.0)
        >>> [round(float(value), 6) for value in s.exponents]  # −a, and −a − 2 × strength
        [-1.0, -2.0]
    """
    fits = isinstance(node, Flow | Map | Hybrid) and not isinstance(node, EventDriven)
    require(fits, f"coupled_network takes an lh.Flow, lh.Map or lh.Hybrid; got {type(node).__name__}.")
    require_callable("coupling", coupling, "(t, x, args) -> (m,)")
    if enters is not None:
        require_callable("enters", enters, "(args, input) -> args")
    matrix = np.asarray(numbers("matrix", matrix), float)
    square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1] >= 1
    require(square, f"matrix must have shape (N, N); got {matrix.shape}.")
    off = np.max(np.abs(matrix.sum(axis=1)))
    require(
        off <= ROW_SUM * (1 + np.max(np.abs(matrix))),
        f"The rows of matrix must sum to 0, so that equal nodes do not act on each other; they sum to up to {off:.3g}. "
        "From an adjacency matrix A make A - numpy.diag(A.sum(axis=1)).",
    )
    wiring = NodeWiring(coupling, jnp.asarray(matrix), enters)
    everyone = tuple(range(len(matrix)))
    if isinstance(node, Map):
        return Map(of_group(wiring, [(node.rule, everyone)], adds=True), **_labels(node, len(matrix)))
    if isinstance(node, Flow):
        require(not isinstance(node.field, Constrained), "coupled_network takes no lh.DAE: eliminate its constraints.")
        return Flow(of_group(wiring, [(node.field, everyone)], adds=True), **_labels(node, len(matrix)))
    return _hybrid(node, wiring, len(matrix))


def _labels(node: Flow | Map | Hybrid, count: int) -> dict[str, Any]:
    """Names and units of all components, x1, v1, x2, v2, and so on; the unit of time, where there is one."""
    names = node.names and [f"{name}{i + 1}" for i in range(count) for name in node.names]
    time = {} if node.time_unit is None else {"time_unit": node.time_unit}
    return {"names": names, "units": node.units and [*node.units] * count, **time}


def _hybrid(node: Hybrid, wiring: NodeWiring, count: int) -> Hybrid:
    """The network of nodes that jump: its modes are the combinations of theirs, the last node's changing fastest."""
    fields, modes = node.fields, node.mode_names
    require(
        fields is not None, "coupled_network needs nodes that flow; this lh.Hybrid has fields=None: write an lh.Map."
    )
    assert fields is not None, "checked above"
    constrained = any(isinstance(field, Constrained) for field in fields)
    require(not constrained, "coupled_network takes no lh.DAE: eliminate its constraints.")
    require(not any(node.flow_sets), "coupled_network takes an lh.Hybrid without flow_set.")
    bound = [name for name, one in zip(modes, node.tangent, strict=True) if one is not None]
    require(not bound or wiring.enters is not None, BOUND_NODES.format(bound))
    total = len(modes) ** count
    require(total <= COMBINATIONS or len(modes) == 1, TOO_MANY_MODES.format(count, len(modes), total, COMBINATIONS))
    combinations = list(itertools.product(range(len(modes)), repeat=count))
    names = [",".join(modes[q] for q in one) for one in combinations] if len(modes) > 1 else list(modes)

    def groups(functions: Sequence[Any], one: Sequence[int]):
        """The functions of the modes that occur in a combination, each with its nodes."""
        return [(functions[q], tuple(i for i, other in enumerate(one) if other == q)) for q in sorted(set(one))]

    tangent = {
        name: projected(wiring, groups(node.tangent, one)) for name, one in zip(names, combinations, strict=True)
    }
    return Hybrid(
        {n: of_group(wiring, groups(fields, one), adds=True) for n, one in zip(names, combinations, strict=True)},
        [
            network
            for one in node.transitions
            for network in _transitions(one, modes, wiring, dict(zip(names, combinations, strict=True)))
        ],
        tangent=tangent if bound else None,
        max_cascade=node.max_cascade and node.max_cascade * count,
        initial_mode=node.initial_mode and of_start(wiring, node.initial_mode, len(modes)),
        **_labels(node, count),
    )


def _transitions(transition: Transition, modes, wiring: NodeWiring, combinations: dict) -> list[Transition]:
    """A transition of a node as those of the network: one, or one for each combination in which it is armed."""
    count = wiring.count
    if len(modes) == 1 or (transition.source is None and transition.target is None):
        return [_of_nodes(transition, modes, wiring, None, None, tuple(range(count)))]
    armed = {modes.index(name) for name in transition.source or modes}
    chosen = {name: tuple(i for i in range(count) if one[i] in armed) for name, one in combinations.items()}
    return [
        _of_nodes(transition, modes, wiring, name, one, chosen[name])
        for name, one in combinations.items()
        if chosen[name]
    ]


def _of_nodes(transition: Transition, modes, wiring: NodeWiring, source, combination, chosen) -> Transition:
    """The transition of the nodes `chosen` in a combination of modes; None: of all combinations."""
    target = transition.target
    if isinstance(target, str):
        target = modes.index(target)
    if target is not None:
        target = target_of(wiring, transition, target, len(modes), combination or (0,) * wiring.count, chosen)
    shared: dict[str, Any] = {
        "source": source, "target": target, "direction": transition.direction, "terminal": transition.terminal,
    }  # fmt: skip
    if transition.is_clock:
        require(transition.when is None, "coupled_network takes clocks without when=….")
        leaves = isinstance(transition.target, str) and transition.target not in (transition.source or modes)
        require(target is None or leaves or len(modes) == 1, CLOCK_OF_NODES)
        reset = transition.reset and of_group(wiring, [(transition.reset, chosen)])
        clock = {"every": of_clock(transition.every), "phase": of_clock(transition.phase)}
        return Transition(None, reset, **clock, **shared)
    guard = transition.guard
    assert guard is not None, "no clock"
    if transition.when is not None:
        shared["when"] = of_each(wiring, transition.when, chosen, like=guard)
    reset = transition.reset and of_one(wiring, transition.reset, guard, chosen)
    return Transition(of_each(wiring, guard, chosen), reset, **shared)
