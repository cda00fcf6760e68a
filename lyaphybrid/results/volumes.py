"""Volume error of a fixed step, for runs with too few columns for the sum rule."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jax.engines import compiled
from .._linalg import frames
from ..engine import binding, problems
from ..engine.evolvers.stepping import Stepping
from ..events.compiled_hybrid import by_mode
from ..integrators import RungeKutta

__all__ = ["MOST_COMPONENTS_OF_VOLUMES", "volume_error"]

STEPS_CHECKED = 32  # number of steps, from the final state on
MOST_COMPONENTS_OF_VOLUMES = 16  # most components: the volume of a step costs n³ operations


def volume_error(problem: problems.RunProblem, t, x, mode) -> Array | None:
    """The mean of |ln|det D step| − ∫ tr Df dt| over a few steps from (t, x) on.

    None where it is not computed: symplectic steps conserve volumes, and adaptive steps have an error control. Events
    are ignored: the steps use the vector field of the final mode.
    """
    if (
        not isinstance(problem.method, RungeKutta)
        or problem.method.adaptive
        or x.shape[-1] > MOST_COMPONENTS_OF_VOLUMES
    ):
        return None
    if x.ndim == 2:  # of several runs use the first
        t, x, mode = (leaf[0] if jnp.ndim(leaf) else leaf for leaf in (t, x, mode))
    return _volume_error(problem, jnp.asarray(t), jnp.asarray(x), jnp.asarray(mode))


@compiled()
def _volume_error(problem: problems.RunProblem, t, x, mode):
    evolver, method = binding.evolver_of(problem, t, x), problem.method
    assert isinstance(evolver, Stepping), "what has a method has fields"
    if evolver.hybrid.constrained:
        return jnp.full_like(t, jnp.nan)
    h = jnp.asarray(method.fixed_step, x.dtype)

    def in_mode(field):
        def step(t, x):
            moved = method.tangent(field, t, x, h, jnp.eye(x.shape[0], dtype=x.dtype))
            return moved.x, frames.log_abs_det(moved.frame) - method.divergence(field, moved.nodes, h)

        return step

    def one(state, _):
        t, x = state
        x, error = by_mode(mode, [in_mode(field) for field in evolver.hybrid.fields], t, x)
        return (t + h, x), jnp.abs(error)

    return jnp.mean(jax.lax.scan(one, (t, x), None, length=STEPS_CHECKED)[1])
