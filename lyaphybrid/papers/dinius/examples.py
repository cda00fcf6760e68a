"""Small example systems for remarks in the paper of Dinius."""

import jax.numpy as jnp
import numpy as np

from ...analysis.multiple_solutions import solutions
from ...results.solution_sets import Solutions
from ...systems.hybrid import Hybrid, Transition

__all__ = ["FIRST_MATRIX", "SECOND_MATRIX", "STRIKES", "orders_of_two_clocks"]

FIRST_MATRIX, SECOND_MATRIX = np.array([[2.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0], [1.0, 3.0]])
STRIKES = 3


def _clock(i: int, matrix: np.ndarray) -> Transition:
    """The clock x_i ticks at 1 and is reset to 0; w = (x₂, x₃) becomes matrix · w."""

    def reset(t, x, args):
        return jnp.concatenate([x[:2].at[i].set(0.0), jnp.asarray(matrix, x.dtype) @ x[2:]])

    return Transition(lambda t, x, args: 1.0 - x[i], reset)


def orders_of_two_clocks() -> Solutions:
    """Two clocks tick at the same time, three times, with resets of w that do not commute: eight solutions."""
    system = Hybrid(
        lambda t, x, args: jnp.array([1.0, 1.0, 0.0, 0.0], x.dtype), [_clock(0, FIRST_MATRIX), _clock(1, SECOND_MATRIX)]
    )
    return solutions(system, np.zeros(4), t1=STRIKES + 0.5, blocks=2)
