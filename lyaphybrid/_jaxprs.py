"""Parts of what a user's function is made of: some of the equations of its jaxpr, as a function."""

from collections.abc import Callable

from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

__all__ = ["part_of"]


def part_of(closed: ClosedJaxpr, equations, inputs, outputs) -> Callable[..., list]:
    """Some of the equations as a function."""
    part = closed.jaxpr.replace(eqns=equations, invars=inputs, outvars=outputs)
    return jaxpr_as_fun(ClosedJaxpr(part, closed.consts))
