"""Systems: mathematics, no numerics.

A system says what moves (a field, a rule, a closed-form flow), what interrupts the motion (guards, clocks,
the next event) and what happens then (resets). User functions are pure JAX functions of ``(t, x, args)``;
``args`` is any pytree of parameters and ``x`` has shape ``(n,)``. Nobody writes a Jacobian.
"""
