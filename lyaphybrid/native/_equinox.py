"""Rules for primitives of Equinox's that do nothing here; its others are expanded (see `_expansion`)."""

from ._lowering import KEEPS_ROWS, rule

KEEPS_ROWS |= {"nondifferentiable_backward", "announce_jaxpr", "select_if_vmap"}


@rule("nondifferentiable_backward", "announce_jaxpr")
def unchanged(b, eqn, *values):
    return list(values)


@rule("select_if_vmap")
def select_if_vmap(b, eqn, condition, value, other):
    """Without vmap a loop makes no turn for which the condition does not hold."""
    return value
