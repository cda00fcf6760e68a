"""The jumps of a trial run: what resets and targets do, how guards are met, and which are passed the other way."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import for_once
from ...engine.evolvers.landing import GRAZING
from ...systems.hybrid import Hybrid, Transition
from ...systems.validation.indices import entry_beyond_the_end
from ..trajectories import Trajectory
from .report import Finding, in_short, noted, right, wrong

__all__ = ["check_jumps", "check_targets"]

COMPONENTS = 4  # of a vector guard that never fired, looked at
BEYOND = 1e-9  # a guard is on its fired side after a jump if it is by more than this part of its terms


class _Guard:
    """A guard with `args` bound, positive before it fires; of a vector guard one component."""

    def __init__(self, transition: Transition, args: Any, t, x):
        guard, sign = transition.guard, -1.0 if transition.direction > 0 else 1.0
        assert guard is not None
        shape = jax.eval_shape(guard, t, x, args).shape
        self.width = shape[0] if shape else 1

        def component(t, x, which):
            return sign * jnp.atleast_1d(guard(t, x, args))[which]

        def all_of(t, x, which):
            value, (moving, gradient) = jax.value_and_grad(component, argnums=(0, 1))(t, x, which)
            return [value, moving, gradient]

        self._all = for_once(all_of, t, x, np.zeros((), np.int32))

    def value(self, t, x, which) -> float:
        """Its value."""
        return float(self._all(t, x, which)[0])

    def gradient(self, t, x, which) -> tuple[float, np.ndarray]:
        """Its derivatives by time, and by the state (n,)."""
        _, moving, gradient = self._all(t, x, which)
        return float(moving), np.asarray(gradient)

    def size(self, t, x, which) -> float:
        """The size of its terms."""
        moving, gradient = self.gradient(t, x, which)
        return float(abs(moving * t) + np.sum(np.abs(gradient * x)) + np.max(np.abs(gradient)) * 1e-3)

    def rate(self, t, x, which, f) -> float:
        """Its time derivative along the flow f."""
        moving, gradient = self.gradient(t, x, which)
        return float(moving + np.sum(gradient * f))

    def sees_the_same(self, t, before, after, which) -> bool:
        """Whether the components on which the guard depends are the same in two states."""
        _, gradient = self.gradient(t, before, which)
        moved = np.abs(after - before) > BEYOND * (np.abs(before) + 1e-3 * np.max(np.abs(before)))
        return not np.any(moved & (gradient != 0))

    def angle(self, t, x, which, f, scales) -> float:
        """The sine of the angle between the flow and the guard, in units of the scales (n,); 1 for one of time."""
        moving, gradient = self.gradient(t, x, which)
        terms = abs(moving) + float(np.linalg.norm(gradient * scales) * np.linalg.norm(f / scales))
        return abs(self.rate(t, x, which, f)) / terms if terms > 0 else 0.0


def check_targets(system: Hybrid, args: Any, run: Trajectory) -> list[Finding]:
    """Targets that are no mode of the system."""
    found = []
    for j, transition in enumerate(system.transitions):
        own = np.flatnonzero(run.events.transition == j)[:5]
        of = transition.guard
        is_vector = of is not None and bool(jax.eval_shape(of, run.t[0], run.x[0], args).shape)
        found += _of_target(system, j, args, run, own, is_vector)
    return found


def check_jumps(system: Hybrid, args: Any, slope: Callable, run: Trajectory) -> list[Finding]:
    """What the jumps of a run show; `slope` is the field (t, x, mode) -> dx/dt."""
    found: list[Finding] = []
    counts = np.bincount(run.events.transition, minlength=len(system.transitions))
    for j, transition in enumerate(system.transitions):
        own = np.flatnonzero(run.events.transition == j)[:5]
        if transition.guard is None:
            continue
        guard = _Guard(transition, args, run.t[0], run.x[0])
        found += _of_labels(j, transition, guard.width, args, run)
        found += _of_landing(system, j, guard, slope, run, own)
        found += _of_contact(j, guard, slope, run, own)
        if not counts[j]:
            found += _passed_unfired(system, j, guard, run) or _starts_beyond(system, j, guard, run)
    total = int(counts.sum())
    if not total:
        return found or [right("jumps", "none in the trial run: nothing is known of guards, resets and targets")]
    said = ", ".join(f"transition {j}: {count}" for j, count in enumerate(counts))
    return found or [right("jumps", f"{total} in the trial run ({said}); resets, targets and contacts are sound")]


def _of_target(system: Hybrid, j: int, args: Any, run: Trajectory, own, is_vector: bool) -> list[Finding]:
    target = system.transitions[j].target
    if not callable(target) or not len(own):
        return []
    e = run.events
    operands = [e.t, e.x_before, *([e.which] if is_vector else [])]
    of_one = for_once(lambda t, x, *which: [target(t, x, args, *which)], *(one[0] for one in operands))
    for i in own:
        index = int(of_one(*(one[i] for one in operands))[0])
        if not 0 <= index < len(system.mode_names):
            return [
                wrong("jumps", f"The target of transition {j} is the mode {index} at t = {float(e.t[i]):.6g}; "
                      f"there are the modes 0 to {len(system.mode_names) - 1}: {list(system.mode_names)}.")
            ]  # fmt: skip
    return []


def _of_labels(j: int, transition: Transition, width: int, args: Any, run: Trajectory) -> list[Finding]:
    """A reset of a vector guard that takes entries beyond the end of an array for its last components."""
    if width == 1 or transition.reset is None:
        return []
    which = np.int32(width - 1)
    closed = jax.make_jaxpr(transition.reset)(run.t[0], run.x[0], args, which)
    beyond = entry_beyond_the_end(closed, [*[None] * (len(closed.jaxpr.invars) - 1), which])
    if beyond is None:
        return []
    return [noted("jumps", f"The guard of transition {j} has {width} components, and for which = {which} its reset "
                  f"takes entry {beyond.entry} along axis {beyond.axis} of an array of shape {beyond.shape}. JAX takes "
                  "the last entry instead, without a word. Has an array of args the wrong shape?")]  # fmt: skip


def _of_landing(system: Hybrid, j: int, guard: _Guard, slope: Callable, run: Trajectory, own) -> list[Finding]:
    """Where a reset leaves the state: off its own guard, and where the field of the next mode is defined."""
    e = run.events
    for i in own:
        t, x, which, mode = e.t[i], e.x_after[i], e.which[i], int(e.mode_after[i])
        f = slope(t, x, mode)
        if not np.all(np.isfinite(f)):
            return [wrong("jumps", f"After transition {j} at t = {float(t):.6g} the field of mode "
                          f"{system.mode_names[mode]!r} is not finite: {in_short(f)}, x = {in_short(x)}.")]  # fmt: skip
        source = system.transitions[j].source
        armed = source is None or system.mode_names[mode] in source
        stays = np.array_equal(e.x_before[i], x)
        if not armed or stays or system.transitions[j].direction == 0:
            continue
        value, small = guard.value(t, x, which), BEYOND * guard.size(t, x, which)
        if value < -small:
            return [wrong("jumps", f"The reset of transition {j} ends on the fired side of its own guard (by "
                          f"{-value:.3g}, at t = {float(t):.6g}), so that it fires again at once. It must end on the "
                          "guard or before it.")]  # fmt: skip
        if not guard.sees_the_same(t, e.x_before[i], x, which):  # the reset leads to another place on the guard
            continue
        arriving = slope(t, e.x_before[i], e.mode_before[i])
        rate, before = guard.rate(t, x, which, f), guard.rate(t, e.x_before[i], which, arriving)
        if abs(value) > small or rate >= -GRAZING * abs(before):
            continue
        when = f"at t = {float(t):.6g}"
        if abs(rate - before) <= BEYOND * abs(before):  # nothing that moves the guard was changed
            return [noted("jumps", f"The reset of transition {j} changes nothing that moves its guard, and the state "
                          f"goes on beyond it, first {when}. Right for a timer, or a level that is passed; a body "
                          "would be inside the wall.")]  # fmt: skip
        return [wrong("jumps", f"After the reset of transition {j} {when} the state goes on through the guard, to the "
                      f"side on which it had fired: x = {in_short(e.x_before[i])} becomes {in_short(x)}. Is a sign in "
                      "the reset wrong, or is a target mode missing?")]  # fmt: skip
    return []


def _of_contact(j: int, guard: _Guard, slope: Callable, run: Trajectory, own) -> list[Finding]:
    e = run.events
    states = np.concatenate([run.x, e.x_before])
    states = states[np.all(np.isfinite(states), axis=1)]
    ranges = np.max(np.abs(states - states[:1]), axis=0, initial=0.0)
    scales = np.where(ranges > 0, ranges, 1.0)  # so that the angle does not depend on the units
    for i in own:
        f = slope(e.t[i], e.x_before[i], e.mode_before[i])
        angle = guard.angle(e.t[i], e.x_before[i], e.which[i], f, scales)
        if angle < GRAZING:
            return [noted("jumps", f"The flow meets the guard of transition {j} nearly tangentially at t = "
                          f"{float(e.t[i]):.6g} (sine of the angle {angle:.1e}): there the saltation matrix is very "
                          "large, and a small change decides whether the event happens.")]  # fmt: skip
    return []


def _starts_beyond(system: Hybrid, j: int, guard: _Guard, run: Trajectory) -> list[Finding]:
    """A guard that never fired, on whose fired side the run began: it would fire only after the state came back."""
    t, x, transition, mode = run.t[0], run.x[0], system.transitions[j], int(run.mode[0])
    armed = transition.source is None or system.mode_names[mode] in transition.source
    if transition.direction == 0 or not armed or system.flow_sets[mode] is not None:  # which lets it jump at once
        return []
    values = [guard.value(t, x, i) for i in range(min(guard.width, COMPONENTS))]
    which = int(np.argmin(values))
    if values[which] >= -BEYOND * guard.size(t, x, which):
        return []
    return [noted("jumps", f"The start is beyond the guard of transition {j} (by {-values[which]:.3g}), on the side on "
                  "which it has fired already, and it never fired in the trial run. Does the start lie inside the "
                  "wall, or is a sign of the guard wrong?")]  # fmt: skip


def _passed_unfired(system: Hybrid, j: int, guard: _Guard, run: Trajectory) -> list[Finding]:
    """A guard that never fired, and crossed zero in the direction in which it does not fire."""
    transition = system.transitions[j]
    if transition.direction == 0:
        return []
    t, x, mode, j_done = run.t, run.x, run.mode, run.j
    here = np.ones(len(t), bool)
    if transition.source is not None:
        here &= np.isin(mode, [system.mode_names.index(name) for name in transition.source])
    which = range(min(guard.width, COMPONENTS))
    values = np.array([[guard.value(*each, i) for i in which] for each in zip(t, x, strict=True)])
    same = here[:-1] & here[1:] & (j_done[:-1] == j_done[1:]) & (mode[:-1] == mode[1:])
    count = int(np.sum(same[:, None] & (values[:-1] < 0) & (values[1:] > 0)))
    if not count:
        return []
    way, other = ("falls", "rose") if transition.direction < 0 else ("rises", "fell")
    return [noted("jumps", f"The guard of transition {j} never fired, but it {other} through zero {count} times in the "
                  f"trial run. It fires where it {way}: is direction={transition.direction} right?")]  # fmt: skip
