"""Calling a function of the user abstractly: what it returns, or one message about what is wrong with it."""

import inspect
from collections.abc import Callable
from typing import Any

import jax

from ...errors import UserFunctionError
from .explanations import Call, explained, order_of_arguments
from .indices import Beyond, entry_beyond_the_end
from .places import place_of_equation

__all__ = ["call_of", "check_signature", "results_of"]


def call_of(name: str, function: Callable, given: str, *arguments) -> Call:
    """A call of a function, with the names of its arguments as in "t, x, args"."""
    return Call(name, function, dict(zip(given.split(", "), arguments, strict=True)))


def results_of(call: Call) -> Any:
    """The shapes and types that a function returns.

    Raises:
        UserFunctionError: on the wrong number of arguments, whatever fails in the function, and entries beyond the end
            of an array.
    """
    check_signature(call)
    try:
        closed, results = jax.make_jaxpr(call.function, return_shape=True)(*call.given.values())
    except UserFunctionError:  # of a function within this one
        raise
    except Exception as error:
        raise UserFunctionError(explained(call, error)) from None
    found = entry_beyond_the_end(closed)
    if found:
        raise UserFunctionError(_beyond(call, found))
    return results


def check_signature(call: Call) -> None:
    """Refuse a function that cannot be called with so many arguments."""
    try:
        inspect.signature(call.function).bind(*call.given.values())
    except TypeError as error:
        cure = "give it all of these arguments, also those that it does not use"
        if list(call.given) == ["t", "x", "args"]:
            cure += "; f(t, x) becomes lambda t, x, args: f(t, x)"
        elif list(call.given)[-1] == "which":
            cure += "; a guard of shape (m,) says which of its components fires; one that returns x[0] does not"
        raise UserFunctionError(
            f"The {call.name} is called with {call.signature}: {error}; {cure}.{order_of_arguments(call)}"
        ) from None
    except ValueError:  # a builtin without a signature
        pass


def _beyond(call: Call, found: Beyond) -> str:
    """Of an entry that is not there."""
    place = place_of_equation(found.eqn)
    where = f" {place}" if place else ""
    scatters = found.eqn.primitive.name.startswith("scatter")
    does, instead = ("sets", "change nothing") if scatters else ("takes", "take another entry")
    index = found.entry - found.shape[found.axis] * (found.entry < 0)  # as it was written
    return (
        f"The {call.name} {does} entry {index}{where} along axis {found.axis} of an array of shape {found.shape}, "
        f"whose entries are 0 to {found.shape[found.axis] - 1}. JAX would {instead}, without a word. {call}"
    )
