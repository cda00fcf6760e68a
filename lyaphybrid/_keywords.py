"""What the wrappers of verbs need: what to write instead of arguments that they do not take, the user's own line."""

import difflib
import functools
import inspect
import re
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

__all__ = ["explains_keywords", "user_level"]

P = ParamSpec("P")
T = TypeVar("T")

UNEXPECTED_WORDS = " got an unexpected keyword argument"
UNEXPECTED = re.compile(rf"\(\){UNEXPECTED_WORDS} '(\w+)'")
# Names of other libraries, and what to write instead.
ELSEWHERE = {
    **dict.fromkeys(("rtol", "atol", "tol", "reltol", "abstol"), "tolerances go with method=lh.RungeKutta(rtol=…)"),
    "dt": "a fixed step goes with the method, lh.RungeKutta('rk4', dt=…); n=… is a number of samples",
    **dict.fromkeys(
        ("t_end", "tend", "tmax", "t_max", "t_final", "tf", "T", "t2", "t_span", "tspan", "duration"),
        "the length of a run is t1=…",
    ),
    **dict.fromkeys(("solver", "integrator"), "the integrator is method=…"),
    **dict.fromkeys(("params", "parameters", "p", "pars"), "parameters are args=…"),
    **dict.fromkeys(("y0", "u0", "ic", "initial", "initial_state"), "the start is x0=…"),
    **dict.fromkeys(("seed", "rng", "random_state"), "random numbers come from key=jax.random.key(seed)"),
    **dict.fromkeys(("Ttr", "ttr", "t_transient", "burn_in", "discard"), "what is not counted is transient=…"),
    **dict.fromkeys(("n_lyap", "n_exponents", "num_exponents", "dim", "number"), "the number of exponents is k=…"),
    **dict.fromkeys(("verbose", "show_progress", "progress_bar"), "a bar is progress=True"),
}


def explains_keywords(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a verb: arguments that it does not take, or not by place, are answered with what to write instead."""

    @functools.wraps(function)
    def call(*args: P.args, **given: P.kwargs) -> T:
        try:
            return function(*args, **given)
        except TypeError as error:
            message = _answer(function, str(error), given)
            if message is None:
                raise
        raise TypeError(message)

    return call


def _answer(function: Callable, said: str, given: dict[str, Any]) -> str | None:
    """What to say to Python's words about the arguments of a call; None where they are about another call."""
    taken, name = inspect.signature(function).parameters, function.__name__
    too_many = said.startswith(f"{name}() takes ") and "positional argument" in said
    if too_many or said.startswith(f"{name}() got multiple values for argument "):
        by_place = [key for key, one in taken.items() if one.kind is one.POSITIONAL_OR_KEYWORD]
        by_name = [f"{key}=…" for key, one in taken.items() if one.kind is one.KEYWORD_ONLY]
        return f"{said}: by place only {', '.join(by_place)}; by name {', '.join(by_name)}."
    found = UNEXPECTED.search(said)
    if found is None or found[1] not in given or found[1] in taken:
        return None
    return f"{name}(){UNEXPECTED_WORDS} '{found[1]}': {_instead(function, found[1])}."


def user_level() -> int:
    """The `stacklevel` with which a warning of the caller is one of the line outside of this package."""
    frame, level = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").startswith(__package__):
        frame, level = frame.f_back, level + 1
    return level


def _instead(function: Callable, name: str) -> str:
    taken = list(inspect.signature(function).parameters)
    near = difflib.get_close_matches(name, taken, n=1, cutoff=0.75)
    if name in ELSEWHERE and not near:
        return ELSEWHERE[name]
    return f"did you mean {near[0]}=?" if near else f"it takes {', '.join(taken)}"
