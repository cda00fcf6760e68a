"""Our side of the sweeps: lanes as `lh.sweep` runs them once it has compiled, on so many threads."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks import ours, problems
from benchmarks.harness import Make
from lyaphybrid.sweeps.plans import plan
from lyaphybrid.sweeps.sweeping import Work


def _swept(spectrum: Callable, name: str, first: float, last: float, lanes: int, threads: int, work: float) -> Make:
    """Exponents are means over the lanes; `work` is that of one."""

    def make():
        grid = plan({name: np.linspace(first, last, lanes)}, None, {name: first})
        sweep = Work.of(None, lambda args: spectrum(args[name]), {name: first}, grid, lanes // 8)
        sweep.threads = threads

        def run():
            sweep.compute(sweep.pieces(), lambda index, results: None, None, None)
            found = sweep.variables
            assert not found["status"].any(), "a lane has ended early"
            return {"exponents": found["exponents"].mean(axis=0).tolist(), "events": int(found["jumps"].sum())}

        run()
        return run, work * lanes

    return make


def lorenz(threads: int, lanes: float) -> Make:
    """Lorenz63 by RK4 at many ρ; the work is counted in steps."""
    name, steps = problems.LORENZ_SWEEP[0], problems.LORENZ_SWEEP_STEPS
    problem, start = lh.zoo.lorenz63(), jnp.array(problems.LORENZ_START)
    method = lh.RungeKutta(tableau="rk4", dt=problems.LORENZ_DT)

    def spectrum(value):
        how = {"t1": steps * problems.LORENZ_DT, "method": method, "every": 10, "blocks": 16}
        return lh.lyapunov_spectrum(problem.system, start, problem.args | {name: value}, **how)

    return _swept(spectrum, *problems.LORENZ_SWEEP, round(lanes), threads, steps)


def henon_heiles(threads: int, lanes: float) -> Make:
    """Hénon and Heiles by SBAB2C from many starts; the work is counted in steps."""
    steps, system = problems.HENON_HEILES_SWEEP_STEPS, lh.zoo.henon_heiles().system
    x, _, *momenta = problems.HENON_HEILES_START
    method = lh.Symplectic("SBAB2C", dt=problems.HENON_HEILES_DT)

    def spectrum(y):
        how = {"t1": steps * problems.HENON_HEILES_DT, "method": method, "every": 10, "blocks": 16}
        return lh.lyapunov_spectrum(system, jnp.stack([jnp.asarray(x), y, *map(jnp.asarray, momenta)]), None, **how)

    return _swept(spectrum, *problems.HENON_HEILES_SWEEP, round(lanes), threads, steps)


def impact(adaptive: bool, threads: int, lanes: float) -> Make:
    """The impact oscillator at many restitutions; the work is counted in units of time."""
    system = lh.Hybrid(ours.oscillate, [lh.Transition(ours.gap, ours.rebound)])
    every = problems.IMPACT_EVERY_TIME if adaptive else problems.IMPACT_EVERY
    method = _method(adaptive, problems.IMPACT_DT, problems.IMPACT_RTOL, problems.IMPACT_ATOL)
    known = problems.IMPACT_START, problems.IMPACT_PARAMETERS, problems.IMPACT_SWEEP
    return _oscillators(system, *known, method, every, threads, lanes)


def friction(adaptive: bool, threads: int, lanes: float) -> Make:
    """The pendulum with dry friction at many dampings; the work is counted in units of time."""
    every = problems.FRICTION_EVERY_TIME if adaptive else problems.FRICTION_EVERY
    method = _method(adaptive, problems.FRICTION_DT, problems.FRICTION_RTOL, problems.FRICTION_ATOL)
    known = problems.FRICTION_START, problems.FRICTION_PARAMETERS, problems.FRICTION_SWEEP
    return _oscillators(ours.RUBBED, *known, method, every, threads, lanes)


def _method(adaptive: bool, dt: float, rtol: float, atol: float) -> lh.RungeKutta:
    return lh.RungeKutta("dopri5", rtol=rtol, atol=atol) if adaptive else lh.RungeKutta("rk4", dt=dt)


def _oscillators(system, start, args, swept, method, every, threads: int, lanes: float) -> Make:
    name, start, t1 = swept[0], jnp.array(start), problems.OSCILLATORS_SWEEP_T1

    def spectrum(value):
        return lh.lyapunov_spectrum(system, start, args | {name: value}, t1=t1, method=method, every=every, blocks=16)

    return _swept(spectrum, *swept, round(lanes), threads, t1)
