"""Whether a surface that depends on the parameter has moved over a state: from there it would never fire."""

import jax.numpy as jnp
import numpy as np

from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates

__all__ = ["moved_over"]


def moved_over(system, t, x, mode, before, after):
    """Whether the state (n,) is beyond the guard of a transition of its mode with the parameters `after`.

    And was not with those `before`: what lies beyond a guard for another reason, a jump for one, may stay there.
    """
    over = jnp.asarray(False)
    if not isinstance(system, Hybrid) or iterates(system):
        return over
    for transition in system.transitions:
        if transition.guard is None or transition.changes_nothing:
            continue
        was, now = (jnp.atleast_1d(transition.guard(t, x, args)) for args in (before, after))
        fell, rose = (was > 0) & (now <= 0), (was < 0) & (now >= 0)
        passed = {-1: fell, 1: rose, 0: fell | rose}[transition.direction]
        if transition.when is not None:
            passed &= transition.when(t, x, after)  # one for all components of the guard, or one for each
        passed = jnp.any(passed)
        if transition.source is not None:
            ends = np.array([name in transition.source for name in system.mode_names])
            passed &= jnp.asarray(ends)[mode]
        over |= passed
    return over
