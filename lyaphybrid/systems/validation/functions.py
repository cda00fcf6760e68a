"""Which functions a system has, with which arguments they are called, and what each must return."""

import collections
import contextlib
import weakref
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import positive, real
from ...errors import UserFunctionError
from ..daes.semi_linear import Constrained
from ..event_driven import EventDriven
from ..hamiltonians import HamiltonianField, SeparableField
from ..hybrid import Hybrid, Transition
from ..smooth import Flow, Map
from .calling import call_of, results_of
from .explanations import Call, described, explained, order_of_arguments

__all__ = ["check_clocks", "check_functions", "has_identity_reset"]

MOST_REMEMBERED = 64  # checks that have passed, which keep their functions alive


def check_clocks(system: Any, args: Any) -> None:
    """Check the periods and phases of the clocks, unless they are traced."""
    for j, transition in enumerate(system.transitions if isinstance(system, Hybrid) else ()):
        if transition.guard is None:
            _check_clock(f"every of transition {j}", transition.every, args, positive)
            _check_clock(f"phase of transition {j}", transition.phase, args, real)


def _check_clock(name: str, value, args, good: Callable) -> None:
    if callable(value):
        try:
            value = value(args)
        except Exception as error:
            raise UserFunctionError(explained(call_of(name, value, "args", args), error)) from None
    good(name, value)


def check_functions(system: Any, x: jax.ShapeDtypeStruct, args: Any) -> None:
    """Check arguments and results of each of the user's functions, by abstract evaluation.

    Called where functions are traced. What has passed is not traced again for other programs of the same functions.

    Raises:
        ValueError: on a function with the wrong number of arguments, or the wrong shape or kind of result.
    """
    signature = _signature(system, x, args)
    if signature is not None and signature in _passed:
        _passed.move_to_end(signature)
        return
    t = jax.ShapeDtypeStruct((), x.dtype)
    if isinstance(system, Flow):
        _check_field("field", system.field, t, x, args)
    elif isinstance(system, Map):
        _returns_state("rule", system.rule, x, "n, x, args", t, x, args)
    elif isinstance(system, EventDriven):
        (_check_event_driven if system.schedule is None else _check_scheduled)(system, t, x, args)
    else:
        _check_hybrid(system, t, x, args)
    if signature is not None:
        _passed[signature] = None
        while len(_passed) > MOST_REMEMBERED:
            _passed.popitem(last=False)


_passed: collections.OrderedDict[Any, None] = collections.OrderedDict()  # signatures, the latest last


def _signature(system: Any, x: jax.ShapeDtypeStruct, args: Any) -> Any:
    """What the check depends on: functions, shapes and types, and whole numbers; None where it cannot be compared."""
    leaves, structure = jax.tree.flatten((system, args))
    kinds = tuple(_kind(leaf) for leaf in leaves)
    signature = structure, kinds, x.shape, x.dtype
    try:
        hash(signature)
    except TypeError:
        return None
    return signature


def _kind(leaf: Any) -> tuple:
    if isinstance(leaf, np.ndarray | np.generic):
        return leaf.shape, leaf.dtype
    if isinstance(leaf, jax.Array):
        return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)  # keys have none
    return type(leaf), leaf


def _check_field(name: str, field: Callable, t, x, args) -> None:
    if isinstance(field, SeparableField | HamiltonianField):
        even = f"x = (q, p) is an even number of components, as many positions as momenta; x0 has {x.shape[0]}."
        _require(x.shape[0] % 2 == 0, even)
    if isinstance(field, SeparableField):
        for part, energy, given in (("kinetic", field.kinetic, "p, args"), ("potential", field.potential, "q, args")):
            half, full = jax.ShapeDtypeStruct((x.shape[0] // 2,), x.dtype), f"{part} of the {name}"
            _require_scalar(full, _result(full, energy, given, half, args), jnp.floating, "a number")
    if not isinstance(field, Constrained):
        _returns_state(name, field, x, "t, x, args", t, x, args)
        return
    leading = _result(f"leading of the {name}", field.leading, "t, args", t, args)
    square = getattr(leading, "shape", None) == (*x.shape, *x.shape) and _floating(leading)
    _require(
        square,
        f"The leading of the {name} must return E, a matrix of floats {(*x.shape, *x.shape)} for x of shape {x.shape}; "
        f"got {described(leading)}.",
    )
    _returns_state(f"residual of the {name}", field.residual, x, "t, x, args", t, x, args)
    _require(
        field.n_differential <= x.shape[0],
        f"n_differential must be at most the number of components, {x.shape[0]}; got {field.n_differential}.",
    )


def _check_hybrid(system: Hybrid, t, x, args) -> None:
    for name, field in zip(system.mode_names, system.fields or (), strict=False):
        _check_field(f"field of mode {name!r}", field, t, x, args)
    for name, project in zip(system.mode_names, system.tangent, strict=True):
        if project is not None:
            _returns_state(f"tangent of mode {name!r}", project, x, "t, x, args, dx", t, x, args, x)
    for j, transition in enumerate(system.transitions):
        _check_transition(j, transition, t, x, args)


def _check_transition(j: int, transition: Transition, t, x, args) -> None:
    which: tuple = ()
    shape, given = (), "t, x, args"
    if transition.guard is not None:
        guard = _result(f"guard of transition {j}", transition.guard, given, t, x, args)
        shaped = _floating(guard) and len(guard.shape) < 2 and guard.shape != (0,)
        _require(
            shaped,
            f"The guard of transition {j} must return a scalar or (m,), m ≥ 1, a smooth function that crosses zero; "
            f"got {described(guard)}.",
        )
        shape = guard.shape
        which = (jax.ShapeDtypeStruct((), jnp.int32),) if shape else ()
    if transition.when is not None:
        when = _result(f"when of transition {j}", transition.when, given, t, x, args)
        each = which and getattr(when, "shape", None) == shape and when.dtype == jnp.bool_
        or_each = f", or one for each of its guards {shape}" if which else ""
        if not each:
            _require_scalar(f"when of transition {j}", when, jnp.bool_, f"a single truth value{or_each}")
    given += ", which" if which else ""
    if transition.reset is not None:
        _returns_state(f"reset of transition {j}", transition.reset, x, given, t, x, args, *which)
    if callable(transition.target):
        target = _result(f"target of transition {j}", transition.target, given, t, x, args, *which)
        _require_scalar(f"target of transition {j}", target, jnp.integer, "the index of a mode, one integer")


def has_identity_reset(system: Any, x: jax.ShapeDtypeStruct, args: Any) -> bool:
    """Whether the reset of some transition returns its state unchanged in the same mode (reset=None does not count)."""
    if not isinstance(system, Hybrid):
        return False
    t = jax.ShapeDtypeStruct((), x.dtype)
    return any(_is_identity(transition, t, x, args) for transition in system.transitions)


_known_identities: weakref.WeakKeyDictionary[Callable, bool] = weakref.WeakKeyDictionary()  # trace each reset once


def _is_identity(transition: Transition, t, x, args) -> bool:
    guard, reset = transition.guard, transition.reset
    if guard is None or reset is None or transition.target is not None or transition.terminal:
        return False
    with contextlib.suppress(KeyError, TypeError):  # unknown; or it has no hash
        return _known_identities[reset]
    vector = jax.eval_shape(guard, t, x, args).shape
    which = (jax.ShapeDtypeStruct((), jnp.int32),) if vector else ()
    program = jax.make_jaxpr(lambda x, t, args, *which: reset(t, x, args, *which))(x, t, args, *which).jaxpr
    found = program.outvars[0] is program.invars[0]
    with contextlib.suppress(TypeError):
        _known_identities[reset] = found
    return found


def _check_event_driven(system: EventDriven, t, x, args) -> None:
    _returns_state("flow", system.flow, x, "dt, t, x, args", t, t, x, args)
    which = _predicted("next_event", "dt", _result("next_event", system.next_event, "t, x, args", t, x, args))
    _check_jump(system, t, x, args, which)


def _check_scheduled(system: EventDriven, t, y, args) -> None:
    schedule = system.schedule
    _returns_state("flow", system.flow, y, "dt, y, args", t, y, args)
    cache = _result("init of the schedule", schedule.init, "t, y, args", t, y, args)
    which = _predicted("next of the schedule", "t", _result("next of the schedule", schedule.next, "cache", cache))
    updated = _result("update of the schedule", schedule.update, "cache, t, y, args, which", cache, t, y, args, which)
    shifted = _result("shift of the schedule", schedule.shift, "cache, dt", cache, t)
    for name, other in (("update", updated), ("shift", shifted)):
        same = jax.tree.structure(other) == jax.tree.structure(cache) and all(
            (a.shape, a.dtype) == (b.shape, b.dtype)
            for a, b in zip(jax.tree.leaves(other), jax.tree.leaves(cache), strict=True)
        )
        _require(
            same,
            f"The {name} of the schedule must return a cache like that of init, {described(cache)}; it returned "
            f"{described(other)}.",
        )
    rows = _result("touch of the schedule", schedule.touch, "which", which)
    listed = len(getattr(rows, "shape", ())) == 1 and jnp.issubdtype(rows.dtype, jnp.integer)
    _require(listed, f"The touch of the schedule must return a list of row indices (r,); got {described(rows)}.")
    _check_jump(system, t, jax.ShapeDtypeStruct((rows.shape[0], *y.shape[1:]), y.dtype), args, which)


def _predicted(name: str, time: str, found):
    """Check a prediction (time, which); the shapes of `which`."""
    pair = isinstance(found, tuple) and len(found) == 2 and getattr(found[0], "shape", None) == ()
    _require(pair, f"{name} must return ({time}, which), {time} a single number; got {described(found)}.")
    moment, which = found
    _require(_floating(moment), f"The {time} of {name} must be a float (inf: no event); got {described(moment)}.")
    integers = [jnp.issubdtype(leaf.dtype, jnp.integer) for leaf in jax.tree.leaves(which)]
    good = bool(integers) and all(integers)
    _require(good, f"The which of {name} must be an integer, or a pytree of integers; got {described(which)}.")
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, jnp.int32), which)


def _check_jump(system: EventDriven, t, x, args, which) -> None:
    _returns_state("jump", system.jump, x, "t, x, args, which", t, x, args, which)
    guard = _result("guard", system.guard, "t, x, args, which", t, x, args, which)
    _require_scalar("guard", guard, jnp.floating, "a single number that falls through zero")


def _result(name: str, function: Callable, given: str, *arguments) -> Any:
    """The shapes and types that a function returns."""
    return results_of(call_of(name, function, given, *arguments))


def _returns_state(name: str, function: Callable, x, given: str, *arguments) -> None:
    call = call_of(name, function, given, *arguments)
    result = results_of(call)
    same = getattr(result, "shape", None) == x.shape
    if not same:
        raise UserFunctionError(
            f"The {name} must return an array of x's shape {x.shape}; it returned {described(result)}. "
            f"{_cure(result, call)}{order_of_arguments(call)}"
        )
    _require(
        result.dtype == x.dtype,
        f"The {name} must return {x.dtype}, the type of x; it returned {result.dtype}. "
        f"{_cure_of_type(result.dtype, x.dtype)}.",
    )


def _cure_of_type(got, wanted) -> str:
    """What to do about elements of another type than the state's."""
    if got.kind == "c":
        return "Write the real and the imaginary part as two components"
    if got.kind != "f":
        return "Write 1.0 for 1"
    if got.itemsize > wanted.itemsize:
        return (
            f"Give x0 as {got}, or leave out what makes the result longer: some of args, an array that it closes over"
        )
    return "Leave out what makes it shorter"


def _cure(result: Any, call: Call) -> str:
    """What to do about a result of another shape than the state's."""
    if result is None:
        return "Does it end without `return`?"
    args = getattr(call.given.get("args"), "shape", None)
    if getattr(result, "shape", ()) == args:
        return "That is the shape of args: are x0 and args in each other's place?"
    return "Put components together with jnp.array([…]) or jnp.stack([…])."


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise UserFunctionError(message)


def _floating(result) -> bool:
    return hasattr(result, "dtype") and jnp.issubdtype(result.dtype, jnp.floating)


def _require_scalar(name: str, result, kind, wanted: str) -> None:
    good = getattr(result, "shape", None) == () and jnp.issubdtype(result.dtype, kind)
    _require(good, f"The {name} must return {wanted}; got {described(result)}.")
