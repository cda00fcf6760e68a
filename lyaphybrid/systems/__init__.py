"""Systems: mathematics, no numerics.

A system consists of the motion (a field, a rule, a closed-form flow), its events (guards, clocks, the next event) and
their resets. User functions are pure JAX functions of ``(t, x, args)``; ``args`` is any pytree of parameters and ``x``
has shape ``(n,)``. Jacobians come from automatic differentiation.
"""
