"""The largest exponent as the coupling at which two copies of a system synchronise; the paper's reference [5].

A copy y of the friction pendulum x is pulled towards it, y' = f(y) + d (x − y), friction acting on its own velocity. A
small difference grows as e^{(λ₁ − d) t}: the copy approaches x if d > λ₁, and leaves it if d < λ₁ (a negative d repels
it). No linearisation and no Jacobian are needed. A trial starts with a small difference and ends when it has shrunk or
grown by the same factor (or, after a long time, by less); at d = λ₁ half of the trials end either way, also in chaos,
where the growth scatters. So bisection finds λ₁; in chaos the fraction of trials that synchronise improves it.

A. Stefański & T. Kapitaniak, Using chaos synchronization to estimate the largest Lyapunov exponent of nonsmooth
systems, Discrete Dynamics in Nature and Society 4 (2000) 207–215.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._arguments import require
from ..._jax.precision import GUARD_ROUNDING
from ...analysis.trajectories import trajectory
from ...statuses import STATUS
from ...systems.contacts.filippov import filippov
from ...systems.hybrid import Hybrid, Transition

__all__ = ["TrialStart", "Synchronised", "bisected", "coupled", "midpoint", "synchronised", "trial"]

START_DISTANCE, GROWTH_FACTOR = 1e-6, 1e4  # difference at the start of a trial, and the factor at which it ends
RANGE = (-1.0, 1.0)  # range of the bisection
FEWEST_TRIALS = 30  # in chaos: with fewer one standard error, of first order, holds d₀ in less than 65 % of the cases
LONGEST_TRIAL = 400  # longest trial, in periods
RESOLVED = 8 * GUARD_ROUNDING  # distances below this fraction of the state may be taken for zero when one of both jumps


class Synchronised(NamedTuple):
    """The coupling at the limit of synchronisation.

    Attributes:
        exponent: `midpoint`: on a cycle the middle of the last interval of the bisection, in chaos from all trials.
        error: half the width of that interval, or one standard error of the scatter. Rounding is negligible as long
            as START_DISTANCE/GROWTH_FACTOR is above RESOLVED of the state. The tolerances of the steps do not matter,
            because both copies make the same errors.
        trials: number of trials for each coupling.
        couplings: (steps,) in the order in which they were tried; followed: (steps,) fraction of trials that
        synchronised.
    """

    exponent: float
    error: float
    trials: int
    couplings: np.ndarray
    followed: np.ndarray


class _OfFirst(eqx.Module):
    """A function of the first system, as a function of the state of both."""

    function: Callable

    def __call__(self, t, z, args, *which):
        return self.function(t, z[: len(z) // 2], args["system"], *which)


class _OfSecond(eqx.Module):
    """A function of the second system, as a function of the state of both."""

    function: Callable

    def __call__(self, t, z, args, *which):
        first, second = jnp.split(z, 2)
        return self.function(t, second, args["system"] | {"pulled_to": first, "coupling": args["coupling"]}, *which)


class _Reset(eqx.Module):
    """The reset of one of both systems."""

    of: Callable
    second: bool = eqx.field(static=True)

    def __call__(self, t, z, args, *which):
        first, second = jnp.split(z, 2)
        own = self.of(t, z, args, *which)
        return jnp.concatenate([first, own] if self.second else [own, second])


class _Target(eqx.Module):
    """The pair of modes after a jump of one of both systems."""

    of: Callable
    second: bool = eqx.field(static=True)
    other: int = eqx.field(static=True)
    modes: int = eqx.field(static=True)

    def __call__(self, t, z, args, *which):
        own = self.of(t, z, args, *which)
        return self.other * self.modes + own if self.second else own * self.modes + self.other


class _Pair(eqx.Module):
    """The field of a pair of modes."""

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
    """The field of the second system with the coupling to the first."""

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
    """Two copies of a Filippov system, the second one coupled to the first.

    Args:
        plus: as for `lh.filippov`, with args a dictionary.
        minus: as `plus`.
        surface: as for `lh.filippov`.

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
    """The transition of one of both systems while the other is in this mode."""
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


def synchronised(
    system: Hybrid, x0, args: Any, *, period: float, angles: tuple[int, ...], trials: int, steps: int
) -> Synchronised:
    """λ₁ by bisection of the coupling.

    Args:
        system: of `coupled`.
        x0: (n,) state of the first system at t = 0. Each trial starts at the end of the one before.
        args: its parameters.
        period: of the forcing.
        angles: components of x0 that are angles: each trial starts with them in [−π, π], because rounding grows with
            the angle.
        trials: number for each coupling: one if the first system is on a cycle, in chaos at least FEWEST_TRIALS.
        steps: number of bisection steps.
    """
    require(
        trials == 1 or trials >= FEWEST_TRIALS,
        f"trials must be 1 (on a cycle all trials at a coupling end alike) or at least {FEWEST_TRIALS} (in chaos the "
        "standard error is that of a curve through the fractions that synchronise, and with fewer is too small); "
        f"got {trials}.",
    )
    place = TrialStart(0.0, np.array(x0), np.ones(len(x0)))

    def following(coupling: float) -> int:
        nonlocal place
        count = 0
        for _ in range(trials):
            place.x[list(angles)] = np.remainder(place.x[list(angles)] + np.pi, 2 * np.pi) - np.pi
            follows, place = trial(system, place, args, coupling, period)
            count += follows
        return count

    return bisected(following, trials, steps)


def bisected(following: Callable[[float], int], trials: int, steps: int) -> Synchronised:
    """The limit of synchronisation, by bisection of RANGE.

    Args:
        following: coupling -> how many of the trials synchronise.
        trials: number of trials at each coupling.
        steps: number of bisection steps.
    """
    (low, high), tried, counts = RANGE, [], []
    for _ in range(steps):
        middle = 0.5 * (low + high)
        tried.append(middle)
        counts.append(following(middle))
        low, high = (low, middle) if 2 * counts[-1] > trials else (middle, high)
    couplings, followed = np.array(tried), np.array(counts) / trials
    return Synchronised(*midpoint(couplings, followed, trials), trials, couplings, followed)


def midpoint(couplings, followed, trials: int) -> tuple[float, float]:
    """The coupling d₀ at which half of the trials synchronise, and its standard error.

    ln of the distance is a random walk with the drift λ₁ − d between two barriers at equal distances. It reaches the
    lower one first with the probability p = 1/(1 + e^{−κ(d − d₀)}), d₀ = λ₁, whose parameters
    are found by maximum likelihood; the error is that of d₀ to first order in the errors of both. Where the fractions
    jump from none to all, no κ is the best: then d₀ is the middle between the largest coupling at which none did and
    the smallest at which all did, and the error half their distance.

    Args:
        couplings: (m,) d.
        followed: (m,) fraction of the trials at each that synchronised.
        trials: number of trials at each.
    """
    d, seen = np.asarray(couplings), np.asarray(followed)
    if np.max(d[seen < 1], initial=RANGE[0]) <= np.min(d[seen > 0], initial=RANGE[1]):
        none, every = np.max(d[seen == 0], initial=RANGE[0]), np.min(d[seen == 1], initial=RANGE[1])
        return float(0.5 * (none + every)), float(0.5 * (every - none))
    design = np.stack([np.ones_like(d), d], axis=1)

    def weighed(parameters):
        p = 1 / (1 + np.exp(-design @ parameters))
        return p, trials * (design.T * (p * (1 - p))) @ design

    at = np.array([0.0, 1.0])
    for _ in range(50):
        p, information = weighed(at)
        at = at + np.linalg.solve(information, trials * design.T @ (seen - p))
    covariance = np.linalg.inv(weighed(at)[1])
    middle = -at[0] / at[1]
    by = np.array([-1.0, -middle]) / at[1]  # derivatives of d₀
    return float(middle), float(np.sqrt(by @ covariance @ by))


class TrialStart(NamedTuple):
    """The start of a trial: time, state of the first system, direction to the second."""

    t: float
    x: np.ndarray
    direction: np.ndarray


def trial(system: Hybrid, place: TrialStart, args, coupling: float, period: float) -> tuple[bool, TrialStart]:
    """Whether the copy synchronises, and the start of the next trial.

    The difference keeps its direction for the next trial, because it has aligned with the direction of growth λ₁.
    """
    least = RESOLVED * float(np.max(np.abs(place.x)))
    require(
        START_DISTANCE / GROWTH_FACTOR >= least,
        f"START_DISTANCE / GROWTH_FACTOR must be at least {least:.1e}: guards cannot tell smaller distances of copies "
        f"at {place.x} from zero; got {START_DISTANCE / GROWTH_FACTOR:.1e}. Start farther apart, or keep angles small.",
    )
    direction = place.direction / np.linalg.norm(place.direction)
    start = np.concatenate([place.x, place.x + START_DISTANCE * direction])
    args = {
        "system": args,
        "coupling": jnp.asarray(coupling),
        "closer": jnp.asarray(START_DISTANCE / GROWTH_FACTOR),
        "farther": jnp.asarray(START_DISTANCE * GROWTH_FACTOR),
    }
    run = trajectory(system, start, args, t0=place.t, t1=LONGEST_TRIAL * period, n=1)
    ended = run.status == STATUS.terminated
    times, states = (run.events.t, run.events.x_after) if ended else (run.t, run.x)
    end, state = np.asarray(times)[-1], np.array(states)[-1]  # JAX would compile an index for each number of events
    first, second = np.split(state, 2)
    apart = second - first
    return bool(np.linalg.norm(apart) < START_DISTANCE), TrialStart(float(np.mod(float(end), period)), first, apart)
