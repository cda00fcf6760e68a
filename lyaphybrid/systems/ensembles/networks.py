"""Networks: N identical systems with diffusive coupling as one system."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arguments import numbers, require
from ..bound import require_callable
from ..daes.semi_linear import Constrained
from ..event_driven import EventDriven
from ..hybrid import Hybrid, Transition
from ..smooth import Flow, Map

__all__ = ["coupled_network"]

ROW_SUM = 1e-12  # relative: sums of rows below this are rounding


class _Coupled(eqx.Module):
    """A field, the rule of a map or the reset of a clock, of all nodes; the parameters are (of a node, strength)."""

    function: Callable
    coupling: Callable
    matrix: Float[Array, "N N"]
    enters: Callable | None
    resets: bool = eqx.field(static=True, default=False)

    def __call__(self, t, x, args):
        (own, strength), enters = args, self.enters
        nodes = _rows(x, self.matrix)
        outputs = jax.vmap(lambda x: self.coupling(t, x, own))(nodes)
        # Differences, so that equal nodes do not act on each other, not even by rounding.
        differences = outputs[None, :, :] - outputs[:, None, :]
        inputs = strength * jnp.sum(self.matrix[:, :, None] * differences, axis=1)
        if enters is not None:
            return jax.vmap(lambda x, c: self.function(t, x, enters(own, c)))(nodes, inputs).reshape(-1)
        moved = jax.vmap(lambda x: self.function(t, x, own))(nodes)
        return (moved if self.resets else moved + inputs).reshape(-1)


class _EachNode(eqx.Module):
    """A guard or a condition of all nodes: (N m,)."""

    function: Callable
    matrix: Float[Array, "N N"]

    def __call__(self, t, x, args):
        values = jax.vmap(lambda x: jnp.atleast_1d(self.function(t, x, args[0])))(_rows(x, self.matrix))
        return values.reshape(-1)


class _OneNode(eqx.Module):
    """The reset of the node whose guard fires; all others stay."""

    reset: Callable
    guard: Callable
    matrix: Float[Array, "N N"]

    def __call__(self, t, x, args, which):
        nodes, own = _rows(x, self.matrix), args[0]
        shape = jax.eval_shape(self.guard, t, nodes[0], own).shape
        node, component = (which // shape[0], (which % shape[0],)) if shape else (which, ())
        return nodes.at[node].set(self.reset(t, nodes[node], own, *component)).reshape(-1)


class _OfNode(eqx.Module):
    """The period or the phase of a clock from the parameters of a node."""

    function: Callable

    def __call__(self, args):
        return self.function(args[0])


def _rows(x, matrix):
    """(N, n) the states of the nodes."""
    return x.reshape(matrix.shape[0], -1)


def coupled_network(
    node: Flow | Map | Hybrid, coupling: Callable, matrix: Any, *, enters: Callable | None = None
) -> Flow | Map | Hybrid:
    """N identical systems xᵢ' = f(xᵢ) + strength Σⱼ Gᵢⱼ H(xⱼ) as one system, whose rows of G sum to 0.

    Its state is x₁, …, x_N one after the other, (N n,), and its args are the pair (args of a node, strength). Equal
    nodes stay equal to the last bit. A step costs in proportion to N².

    Args:
        node: an `lh.Flow`, `lh.Map`, or an `lh.Hybrid` with one mode.
        coupling: H, ``(t, x, args) -> (m,)``, with m = n where it is added to the fields.
        matrix: G, (N, N), such as minus the Laplacian of a graph.
        enters: as for `lh.master_stability`.

    Returns:
        An `lh.Flow`, `lh.Map` or `lh.Hybrid`.

    Raises:
        ValueError: on arguments that do not fit; on rows that do not sum to 0; on an `lh.Hybrid` with several modes.

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
    matrix = jnp.asarray(matrix)

    def of(function, resets: bool = False):
        return _Coupled(function, coupling, matrix, enters, resets)

    if isinstance(node, Map):
        return Map(of(node.rule))
    if isinstance(node, Flow):
        require(not isinstance(node.field, Constrained), "coupled_network takes no lh.DAE: eliminate its constraints.")
        return Flow(of(node.field))
    require(
        node.fields is not None and len(node.fields) == 1,
        f"coupled_network takes an lh.Hybrid with one mode; this one has {list(node.mode_names)}: N of them have all "
        "combinations of modes. lh.master_stability tells of any network of them.",
    )
    assert node.fields is not None, "checked above"
    inside = node.flow_sets[0]
    project = node.tangent[0]
    require(inside is None and project is None, "coupled_network takes an lh.Hybrid without flow_set and tangent.")
    return Hybrid(of(node.fields[0]), [_of_nodes(one, of, matrix) for one in node.transitions])


def _of_nodes(transition: Transition, of: Callable, matrix) -> Transition:
    """The transition of a node, for all of them."""
    require(not callable(transition.target), "coupled_network takes transitions without a target: there is one mode.")
    shared: dict[str, Any] = {"direction": transition.direction, "terminal": transition.terminal}
    if transition.when is not None:
        shared["when"] = _EachNode(transition.when, matrix)
    if transition.is_clock:
        require(transition.when is None, "coupled_network takes clocks without when=….")

        def timed(value):
            return _OfNode(value) if callable(value) else value

        reset = transition.reset and of(transition.reset, True)
        return Transition(None, reset, every=timed(transition.every), phase=timed(transition.phase), **shared)
    guard = transition.guard
    assert guard is not None, "no clock"
    reset = transition.reset and _OneNode(transition.reset, guard, matrix)
    return Transition(_EachNode(guard, matrix), reset, **shared)
