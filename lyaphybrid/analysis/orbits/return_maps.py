"""Return maps: from one firing of a transition to the next, as an `lh.Map`."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._arguments import flag
from ..._jax.engines import compiled
from ..._jax.tracing import as_arrays
from ...engine import beginning, binding, loop, preparation, problems
from ...engine.preparation import method_for
from ...integrators import RungeKutta
from ...integrators.base import Method
from ...statuses import STATUS
from ...systems.hybrid import Hybrid
from ...systems.labels import unlabelled
from ...systems.smooth import Map
from .periods import depends_on_time

__all__ = ["return_map"]

MOST_STEPS = 1_000_000  # attempts of a step between two firings
PLAN = problems.RunPlan()


def return_map(system: Hybrid, transition: int = 0, *, with_time: bool = False, method: Method | None = None) -> Map:
    """The map from the state just after one firing of a transition to that just after the next.

    Jumps that follow a firing at the same instant belong to it: the state is that after the last of them.

    Examples: strides of a walker, spikes of a neuron, impacts, samplings; with a section as the guard of a transition
    without reset, a Poincaré map. Its multipliers at a fixed point are those of the periodic orbit (`lh.floquet`), with
    a 0 in place of the trivial 1, since the map ignores perturbations along the flow.

    Args:
        system: an `lh.Hybrid` with fields.
        transition: index of the transition; of a vector guard all components count. That of a clock gives the
            stroboscopic map: iteration n goes from tick n, at t = phase + n · every, to the next.
        with_time: the state of the map is (x, t), for guards of systems that depend on time.
        method: `lh.RungeKutta`; None: the default with rtol = 1e-12.

    Returns:
        An `lh.Map` of (n,), or (n + 1,) with_time. Where the transition does not fire again, or jumps that follow it
        lead to a mode that is not its target, the iterate is nan.

    Raises:
        ValueError: on a system without fields, a transition that does not exist, or a mode after the transition that
            follows neither from its target nor from the state; when called: on a system that depends on time without
            with_time.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -0.8 * x[1]])),
        ... )
        >>> bounce = lh.return_map(ball)
        >>> round(float(bounce.rule(0.0, jnp.array([0.0, 1.0]), None)[1]), 9)
        0.8
    """
    if not isinstance(system, Hybrid) or system.fields is None:
        raise ValueError(f"return_map needs an lh.Hybrid with fields; got {type(system).__name__}.")
    count = len(system.transitions)
    if isinstance(transition, bool) or not isinstance(transition, int | np.integer) or not 0 <= transition < count:
        raise ValueError(f"transition must be an index from 0 to {count - 1}; got {transition!r}.")
    flag("with_time", with_time)
    method = method_for(system, RungeKutta(rtol=1e-12, atol=1e-14) if method is None else method)
    assert method is not None, "a system that flows has one"
    mode = _mode_after(system, int(transition))
    names = None if system.names is None else (*system.names, "t") if with_time else system.names
    times = (system.time_unit,) if with_time else ()  # the unit of the component t
    units = None if system.units is None or None in times else (*system.units, *times)
    return Map(_Return(unlabelled(system), method, int(transition), mode, bool(with_time)), names=names, units=units)


def _mode_after(system: Hybrid, index: int) -> int | None:
    """The mode after the transition; None: the state determines it."""
    names, transition = system.mode_names, system.transitions[index]
    if isinstance(transition.target, str):
        return names.index(transition.target)
    sources = names if transition.source is None else transition.source
    if transition.target is None and len(sources) == 1:
        return names.index(sources[0])
    if system.initial_mode is not None:
        return None
    raise ValueError(
        f"After transition {index} the mode may be any of {list(names)}: give the transition one source and one "
        "target, or the system an initial_mode."
    )


class _Return(eqx.Module):
    """The rule of a return map."""

    system: Hybrid
    method: Method
    transition: int = eqx.field(static=True)
    mode: int | None = eqx.field(static=True)
    with_time: bool = eqx.field(static=True)

    def __call__(self, n, x, args):
        x = jnp.asarray(x)
        return _returned(self, jnp.asarray(n, x.dtype), x, as_arrays(args, x.dtype))


@compiled()
def _returned(rule: _Return, n, x, args):
    fired = rule.system.transitions[rule.transition]
    dim = x.shape[0] - rule.with_time
    state = x[:dim]
    if fired.is_clock:
        every, phase = binding.number(fired.every, args), binding.number(fired.phase, args)
        start, length = phase + n * every, every + 0 * n
    else:
        start, length = x[-1] if rule.with_time else jnp.zeros_like(n), jnp.full_like(n, jnp.inf)
        if not rule.with_time and depends_on_time(rule.system, state, args):
            raise ValueError(
                "This system depends on time: its state at an event alone does not tell the next one. Ask for "
                "return_map(…, with_time=True), whose state is (x, t)."
            )
    problem = problems.RunProblem(rule.system, preparation.at_precision(rule.method, x), args, state.shape)
    settings = binding.settings_of(problem, PLAN, start, state)
    ends = tuple(j == rule.transition and not fired.is_clock for j in range(len(rule.system.transitions)))
    evolver = dataclasses.replace(settings.evolver, terminal=ends, just_fired=rule.transition, whole_instant=True)
    settings = settings._replace(evolver=evolver)
    loop_state = beginning.initial_loop_state(
        settings, start, state, jnp.zeros((dim, 0), x.dtype), rule.mode, None, jnp.ones_like(n)
    )
    loop_state, _ = loop.advance(settings, loop_state, length[None], length[None], jnp.asarray(MOST_STEPS, jnp.int32))
    carry, wanted = loop_state.carry, STATUS.ok if fired.is_clock else STATUS.terminated
    done = (carry.status == int(wanted)) & (loop_state.block == 1)
    if rule.mode is not None and len(rule.system.mode_names) > 1:
        done = done & (carry.solver_state.mode == rule.mode)
    after = jnp.append(carry.x, loop_state.base[0] + loop_state.base[1]) if rule.with_time else carry.x
    return jnp.where(done, after, jnp.nan)
