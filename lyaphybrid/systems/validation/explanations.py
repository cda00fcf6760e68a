"""Why a function of the user fails: the line, the reason and the cure, in one message without the frames of JAX."""

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .places import place_of_error

__all__ = ["Call", "described", "explained", "order_of_arguments"]

STATES, TIMES = {"x", "y", "z", "u", "q", "state", "X", "Y"}, {"t", "time", "tau"}
NUMPY = re.compile(r"\b(np|numpy|onp|sp|scipy|special)\.((?:\w+\.)*)(\w+)")
MATH = re.compile(r"\b(math|cmath)\.(\w+)")
LONGEST_DESCRIPTION = 200  # characters of a description


class Call(NamedTuple):
    """A call of a function of the user."""

    name: str  # what the function is, "field of mode 'up'"
    function: Callable
    given: Mapping[str, Any]  # its arguments by name, in their order

    @property
    def signature(self) -> str:
        """For example ``(t, x, args)``."""
        return f"({', '.join(self.given)})"

    def __str__(self) -> str:
        arguments = ", ".join(f"{name}: {described(value, brief=True)}" for name, value in self.given.items())
        return f"The {self.name} is called with {arguments}."


def explained(call: Call, error: Exception) -> str:
    """What to tell of an error in a function of the user: where, why, what to do, and what the function was given."""
    place = place_of_error(error.__traceback__)
    line = place.text if place else ""
    reason = next(filter(None, (rule(call, error, line) for rule in EXPLANATIONS)))
    where = f" {place}" if place else ""
    return f"The {call.name} fails{where}: {reason}{order_of_arguments(call)} {call}"


def order_of_arguments(call: Call) -> str:
    """A hint where a function seems to be written with the state before the time; else nothing."""
    try:
        names = list(inspect.signature(call.function).parameters)[:2]
    except (TypeError, ValueError):
        return ""
    swapped = list(call.given)[:2] == ["t", "x"] and len(names) == 2 and names[0] in STATES and names[1] in TIMES
    return f" It is written with ({', '.join(names)}, …): the time comes first, {call.signature}." if swapped else ""


def described(value: Any, brief: bool = False) -> str:
    """Shapes and types in words; in brief a single float is a number, and float64 is not mentioned."""
    text = _described(value, brief)
    return text if len(text) <= LONGEST_DESCRIPTION else f"{text[: LONGEST_DESCRIPTION - 2]} …"


def _described(value: Any, brief: bool) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key!r}: {_described(one, brief)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        inner = ", ".join(_described(one, brief) for one in value)
        return f"[{inner}]" if isinstance(value, list) else f"({inner})"
    if not hasattr(value, "shape") or not hasattr(value, "dtype"):
        return repr(value)
    floats = brief and value.dtype == jnp.float64
    if floats and value.shape == ():
        return "a number"
    return f"shape {value.shape}" + ("" if floats else f" of {value.dtype}")


def _in_place(call: Call, error: Exception, line: str) -> str | None:
    by_jax, by_numpy = "JAX arrays are immutable", "setting an array element with a sequence"
    if by_jax not in str(error) and by_numpy not in str(error):
        return None
    whose = "an array of JAX cannot be changed in place" if by_jax in str(error) else (
        "an array of NumPy holds numbers, but JAX writes this function down once, for all states and parameters"
    )  # fmt: skip
    return (
        f"{whose}. Make a new one, x.at[0].set(value) for x[0] = value, or put the components together with "
        "jnp.stack([…])."
    )


def _numpy(call: Call, error: Exception, line: str) -> str | None:
    if not isinstance(error, jax.errors.TracerArrayConversionError):
        return None
    used = NUMPY.search(line)
    cure = "the functions of jax.numpy instead; an array that it looks up goes into args, or becomes jnp.asarray(array)"
    if used and hasattr(jnp, used[3]):
        cure = f"jnp.{used[3]} for {used[0]}, with `import jax.numpy as jnp`"
    elif used and hasattr(jax.scipy.special, used[3]):
        cure = f"jax.scipy.special.{used[3]} for {used[0]}"
    return (
        "NumPy and SciPy need numbers, but JAX writes this function down once, for all states and parameters. "
        f"Use {cure}."
    )


def _decision(call: Call, error: Exception, line: str) -> str | None:
    whole = (jax.errors.TracerBoolConversionError, jax.errors.NonConcreteBooleanIndexError)
    if not isinstance(error, whole):
        return None
    formula = "jnp.where(condition, one, other), jnp.maximum, jnp.minimum"
    cure = f"Use {formula}." if call.name == "run" else (
        "Where the motion itself changes (contact, switch, threshold), give each side a mode of its own: "
        "lh.Hybrid({…}, [lh.Transition(…)]); a change at given times is a clock, lh.Transition(every=…). A formula "
        f"that stays continuous takes {formula}."
    )  # fmt: skip
    return (
        "Python's if, while, and, or, not, max, min and x[x > 0] need one answer at once, but JAX writes this function "
        f"down once, for all states and parameters. {cure}"
    )


def _conversion(call: Call, error: Exception, line: str) -> str | None:
    kinds = (jax.errors.ConcretizationTypeError, jax.errors.TracerIntegerConversionError)
    if not isinstance(error, kinds) and "Only integer scalar arrays" not in str(error):
        return None
    used = MATH.search(line)
    cure = "leave float() out; int() is jnp.floor, or x.astype(int)"
    if used:
        cure = f"use jnp.{used[2]} for {used[0]}, with `import jax.numpy as jnp`" if hasattr(jnp, used[2]) else cure
    return (
        "float(), int(), range(), an index of a list and the functions of math need a number, but JAX writes this "
        f"function down once, for all states and parameters: {cure}. What counts bodies or terms must not be in args: "
        "fix it in the function, as by functools.partial."
    )


def _no_args(call: Call, error: Exception, line: str) -> str | None:
    if "NoneType" not in str(error) or call.given.get("args", 0) is not None:
        return None
    return f"args is None here ({error}): parameters that the function uses are to be given, args=…."


def _no_entry(call: Call, error: Exception, line: str) -> str | None:
    args = call.given.get("args")
    if isinstance(error, KeyError) and isinstance(args, dict):
        return f"there is no {error.args[0]!r}; args has {', '.join(map(repr, args)) or 'no entries'}."
    if isinstance(error, AttributeError) and isinstance(args, dict) and "'dict' object" in str(error):
        return f"args is a dict ({error}): its entries are args['name']."
    if isinstance(error, IndexError) and isinstance(args, list | tuple) and "index out of range" in str(error):
        return f"{error}; args has {len(args)} entries, counted from 0."
    return None


def _no_array(call: Call, error: Exception, line: str) -> str | None:
    found = re.search(r"returned a value of type (.*?)(?: at |, which)", str(error))
    if "not a valid JAX type" not in str(error) or found is None:
        return None
    named = re.sub(r"<class '(.*)'>", r"\1", found[1])
    mode = " The target is the index of a mode, its place among the modes, counted from 0." * ("target" in call.name)
    return f"it returns a {named}, but only numbers and arrays can be computed with.{mode}"


def _as_it_is(call: Call, error: Exception, line: str) -> str:
    """Errors that say themselves what is wrong, in their first line."""
    said = next(iter(str(error).strip().splitlines()), "")
    return f"{type(error).__name__}: {said.rstrip('.')}."


EXPLANATIONS = (_in_place, _numpy, _decision, _conversion, _no_args, _no_entry, _no_array, _as_it_is)
