"""The largest exponent as the coupling at which two copies of a system synchronise; the paper's reference [5].

A copy y of the friction pendulum x is pulled towards it, y' = f(y) + d (x − y), friction acting on its own velocity. A
small difference grows as e^{(λ₁ − d) t}: the copy comes to x if d > λ₁, and leaves it if d < λ₁ (for a negative d it is
pushed away). Nothing is linearised, and nobody writes a Jacobian. A trial begins with a small difference and ends where
this has shrunk or grown by the same factor (or, after long, by less); at d = λ₁ half of the trials end either way, also
in chaos, where the growth scatters. So bisection finds λ₁.

A. Stefański & T. Kapitaniak, Using chaos synchronization to estimate the largest Lyapunov exponent of nonsmooth
systems, Discrete Dynamics in Nature and Society 4 (2000) 207–215.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..filippov import filippov
from ..statuses import STATUS
from ..systems import Hybrid, Transition
from ..trajectories import trajectory

__all__ = ["Synchronised", "coupled", "synchronised"]

START, FACTOR = 1e-6, 1e4  # the difference at the start of a trial; by how much it shrinks or grows until it ends
RANGE = (-1.0, 1.0)  # of couplings that are tried
PATIENCE = 400  # periods of a trial


class Synchronised(NamedTuple):
    """The coupling at which the copy just follows.

    Attributes:
        exponent: the middle of the last interval of the bisection; error: half its width.
        trials: for each coupling that was tried, how many.
        couplings: (steps,) in the order in which they were tried; followed: (steps,) part of trials that synchronised.
    """

    exponent: float
    error: float
    trials: int
    couplings: np.ndarray
    followed: np.ndarray


class _OfFirst(eqx.Module):
    """A function of the first system, of the state of both."""

    function: Callable

    def __call__(self, t, z, args, *which):
        return self.function(t, z[: len(z) // 2], args["system"], *which)


class _OfSecond(eqx.Module):
    """The same of the second, which sees the first."""

    function: Callable

    def __call__(self, t, z, args, *which):
        first, second = jnp.split(z, 2)
        return self.function(t, second, args["system"] | {"pulled_to": first, "coupling": args["coupling"]}, *which)


class _Reset(eqx.Module):
    """A jump of one of both."""

    of: Callable
    second: bool = eqx.field(static=True)

    def __call__(self, t, z, args, *which):
        first, second = jnp.split(z, 2)
        own = self.of(t, z, args, *which)
        return jnp.concatenate([first, own] if self.second else [own, second])


class _Target(eqx.Module):
    """The pair of modes after a jump of one of both."""

    of: Callable
    second: bool = eqx.field(static=True)
    other: int = eqx.field(static=True)
    modes: int = eqx.field(static=True)

    def __call__(self, t, z, args, *which):
        own = self.of(t, z, args, *which)
        return self.other * self.modes + own if self.second else own * self.modes + self.other


class _Pair(eqx.Module):
    """What a pair of modes does."""

    first: Callable
    second: Callable

    def __call__(self, t, z, args):
        return jnp.concatenate([self.first(t, z, args), self.second(t, z, args)])


class _Begin(eqx.Module):
    """The pair of modes to which a state belongs."""

    first: Callable
    second: Callable
    modes: int = eqx.field(static=True)

    def __call__(self, t, z, args):
        first, second = self.first(t, z, args), self.second(t, z, args)
        return jnp.where((first < 0) | (second < 0), -1, first * self.modes + second)


class _Pulled(eqx.Module):
    """A field that is pulled to the first system."""

    field: Callable

    def __call__(self, t, x, args):
        return self.field(t, x, args) + args["coupling"] * (args["pulled_to"] - x)


def _distance(name: str) -> Callable:
    def guard(t, z, args):
        first, second = jnp.split(z, 2)
        return jnp.sum((second - first) ** 2) / args[name] ** 2 - 1

    return guard


CLOSER, FARTHER = _distance("closer"), _distance("farther")


@functools.cache
def coupled(plus: Callable, minus: Callable, surface: Callable) -> Hybrid:
    """Two copies of a Filippov system, the second of them pulled to the first.

    Args:
        plus: as for `lh.filippov`, with args a dictionary.
        minus: the same.
        surface: the same.

    Returns:
        A system of the state (x, y) with args ``{"system": …, "coupling": d, "closer": …, "farther": …}``; a run ends
        where the distance falls through `closer` or rises through `farther`.
    """
    drive, copy = filippov(plus, minus, surface), filippov(_Pulled(plus), _Pulled(minus), surface)
    assert drive.fields is not None
    assert copy.fields is not None
    names, count = drive.mode_names, len(drive.mode_names)
    fields = {
        f"{a}/{b}": _Pair(_OfFirst(drive.fields[i]), _OfSecond(copy.fields[j]))
        for i, a in enumerate(names)
        for j, b in enumerate(names)
    }
    transitions = [Transition(CLOSER, direction=-1, terminal=True), Transition(FARTHER, direction=+1, terminal=True)]
    for system, second in ((drive, False), (copy, True)):
        for transition in system.transitions:
            transitions += [_of_pair(transition, second, other, names) for other in range(count)]
    start = _Begin(_OfFirst(_known(drive)), _OfSecond(_known(copy)), count)
    return Hybrid(fields, transitions, initial_mode=start)


def _known(system: Hybrid) -> Callable:
    assert system.initial_mode is not None
    return system.initial_mode


def _of_pair(transition: Transition, second: bool, other: int, names) -> Transition:
    """The transition of one of both while the other is in this mode."""
    of = _OfSecond if second else _OfFirst
    assert transition.guard is not None
    assert transition.reset is not None
    assert callable(transition.target)
    (own,) = transition.source or ("",)
    return Transition(
        of(transition.guard),
        _Reset(of(transition.reset), second),
        source=f"{names[other]}/{own}" if second else f"{own}/{names[other]}",
        target=_Target(of(transition.target), second, other, len(names)),
        direction=transition.direction,
        when=None if transition.when is None else of(transition.when),
    )


def synchronised(system: Hybrid, x0, args: Any, *, period: float, trials: int, steps: int) -> Synchronised:
    """λ₁ by bisection of the coupling.

    Args:
        system: of `coupled`.
        x0: (n,) where the first system is at t = 0. Each trial goes on from where the one before has ended.
        args: its parameters.
        period: of the forcing.
        trials: for each coupling: one is enough where the first system is on a cycle.
        steps: of the bisection.
    """
    low, high = RANGE
    t, x, tried, followed = 0.0, np.asarray(x0), [], []
    for _ in range(steps):
        middle, count = 0.5 * (low + high), 0
        for _ in range(trials):
            follows, t, x = _trial(system, t, x, args, middle, period)
            count += follows
        tried.append(middle)
        followed.append(count / trials)
        low, high = (low, middle) if 2 * count > trials else (middle, high)
    return Synchronised(0.5 * (low + high), 0.5 * (high - low), trials, np.array(tried), np.array(followed))


def _trial(system: Hybrid, t: float, x: np.ndarray, args, coupling: float, period: float):
    """Whether the copy comes to the first system; when and where this is then."""
    start = np.concatenate([x, x + START / len(x) ** 0.5])
    args = {
        "system": args,
        "coupling": jnp.asarray(coupling),
        "closer": jnp.asarray(START / FACTOR),
        "farther": jnp.asarray(START * FACTOR),
    }
    run = trajectory(system, start, args, t0=t, t1=PATIENCE * period, n=1)
    ended = run.status == STATUS.terminated
    end, state = (run.events.t[-1], run.events.x_after[-1]) if ended else (run.t[-1], run.x[-1])
    first, second = np.split(np.asarray(state), 2)
    return bool(np.linalg.norm(second - first) < START), float(np.mod(float(end), period)), first
