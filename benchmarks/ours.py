"""Our side of the benchmarks: the public interface, each run a whole call, by the code that long runs have."""

import functools
import threading

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks import lattices, problems
from benchmarks import many_disks as many
from benchmarks.harness import Make, Run
from lyaphybrid.native.machine import tiers as _tiers

jax.config.update("jax_enable_x64", True)


def _found(spectrum) -> dict:
    """What a run found, as plain data; waits for it."""
    exponents = np.asarray(jax.block_until_ready(spectrum.exponents))
    events = int(np.asarray(spectrum.jumps))
    return {"exponents": exponents.tolist(), "events": events, "status": str(spectrum.status)}


def with_best_code(run: Run) -> None:
    """Run until the code is the one that long runs have: it is made in a thread while they go on."""
    before, _tiers.AT_LAST = _tiers.AT_LAST, 0
    run()
    for thread in threading.enumerate():
        if thread.name == _tiers.THREAD:
            thread.join()
    _tiers.AT_LAST = before


def _runner(system, x0, args, **keywords) -> Run:
    """A call of `lyapunov_spectrum` with everything bound."""
    spectrum = functools.partial(lh.lyapunov_spectrum, system, jnp.array(x0), args, transient=0.0, **keywords)
    return lambda: _found(spectrum())


def lorenz(every: int, t1: float) -> Make:
    """Lorenz63 by RK4; the work is counted in steps."""

    def make():
        sigma, rho, beta = problems.LORENZ_PARAMETERS
        problem = lh.zoo.lorenz63(sigma=sigma, rho=rho, beta=beta)
        method = lh.RungeKutta(tableau="rk4", dt=problems.LORENZ_DT)
        start = problems.LORENZ_START
        run = _runner(problem.system, start, problem.args, t1=t1, method=method, every=every)
        run()
        return run, t1 / problems.LORENZ_DT

    return make


def henon_heiles(every: int, t1: float) -> Make:
    """The tangent map of SBAB2C; the work is counted in steps."""

    def make():
        problem, dt = lh.zoo.henon_heiles(), problems.HENON_HEILES_DT
        method = lh.Symplectic("SBAB2C", dt=dt)
        run = _runner(problem.system, problems.HENON_HEILES_START, None, t1=t1, method=method, every=every)
        run()
        return run, t1 / dt

    return make


def lattice(name: str, n: int, k: int, every: int, t1: float) -> Make:
    """A disordered lattice of the zoo by its own splitting scheme; the work is counted in steps."""

    def make():
        problem = lh.zoo.get(name)(n=n)
        keywords = {"method": problem.method, "every": every, "frame": lattices.columns(n, k), "blocks": 4}
        run = _runner(problem.system, problem.x0, problem.args, t1=t1, **keywords)
        run()
        return run, t1 / problem.method.dt

    return make


def oscillate(t, x, args):
    """The field of the impact oscillator."""
    acceleration = jnp.cos(args["omega"] * t) - 2 * args["zeta"] * x[1] - x[0]
    return jnp.stack([x[1], acceleration])


def gap(t, x, args):
    """Its guard."""
    return -x[0]


def rebound(t, x, args):
    """Its reset."""
    return jnp.stack([x[0], -args["restitution"] * x[1]])


def _oscillator(system, start, args, adaptive: bool, dt: float, rtol: float, atol: float, **keywords) -> Make:
    """By RK4 or Dormand–Prince; the work is counted in units of time."""

    def make():
        fixed, controlled = {"tableau": "rk4", "dt": dt}, {"tableau": "dopri5", "rtol": rtol, "atol": atol}
        method = lh.RungeKutta(**(controlled if adaptive else fixed))
        run = _runner(system, start, args, method=method, **keywords)
        run()
        return run, keywords["t1"]

    return make


def impact(adaptive: bool, every: float, t1: float) -> Make:
    """The impact oscillator, written out instead of taken from the zoo: the C fixes the signs and the start."""
    system, start, args = (
        lh.Hybrid(oscillate, [lh.Transition(gap, rebound)]),
        problems.IMPACT_START,
        problems.IMPACT_PARAMETERS,
    )
    method = problems.IMPACT_DT, problems.IMPACT_RTOL, problems.IMPACT_ATOL
    return _oscillator(system, start, args, adaptive, *method, t1=t1, every=every)


def _rubbed(sign: float):
    """The field of the pendulum with dry friction where its velocity has a sign."""

    def field(t, x, args):
        drive = args["amplitude"] * jnp.sin(args["omega"] * t)
        return jnp.stack([x[1], drive - args["beta"] * x[1] - args["stiffness"] * jnp.sin(x[0]) - sign * args["alpha"]])

    return field


def velocity(t, x, args):
    """The surface on which its friction jumps."""
    return x[1]


RUBBED = lh.filippov(_rubbed(1.0), _rubbed(-1.0), velocity)


def friction(adaptive: bool, every: float, t1: float) -> Make:
    """The pendulum with dry friction."""
    method = problems.FRICTION_DT, problems.FRICTION_RTOL, problems.FRICTION_ATOL
    start, args = problems.FRICTION_START, problems.FRICTION_PARAMETERS
    return _oscillator(RUBBED, start, args, adaptive, *method, t1=t1, every=every)


def spring_damper(continuous: bool, t1: float) -> Make:
    """The DAE of the spring with a damper; the work is counted in units of time."""

    def make():
        problem = lh.zoo.spring_damper_dae(**problems.SPRING_PARAMETERS)
        method = lh.HalfExplicit(rtol=problems.SPRING_TOL, atol=problems.SPRING_TOL)
        method = lh.ContinuousQR(method) if continuous else method
        run = _runner(problem.system, problems.SPRING_START, problem.args, t1=t1, method=method, k=2)
        run()
        return run, t1

    return make


def dampings_swept(dampings):
    """Exponents (lanes, 2) for each damping, one after the other; `jax.jit` makes one loop of it."""
    method = lh.HalfExplicit(rtol=problems.SPRING_TOL, atol=problems.SPRING_TOL)

    def lane(damping):
        problem = lh.zoo.spring_damper_dae(**(problems.SPRING_PARAMETERS | {"damping": damping}))
        t1 = problems.SPRING_SWEEP_T1
        return problem.spectrum(t1=t1, transient=0.0, k=2, method=method, blocks=2).exponents

    return jax.lax.map(lane, dampings)


def spring_damper_sweep(lanes: float) -> Make:
    """Many dampings; the work is counted in lanes, and the exponents are means over them."""

    def make():
        swept, dampings = jax.jit(dampings_swept), jnp.linspace(*problems.SPRING_DAMPINGS, round(lanes))

        def run():
            return {"exponents": np.asarray(swept(dampings)).mean(axis=0).tolist(), "events": 0}

        run()
        return run, lanes

    return make


def many_disks(n: int, every: int, collisions: float) -> Make:
    """Hard disks in number, all columns."""

    def make():
        x0, (width, height) = many.lattice_start(n)
        problem = lh.zoo.hard_disks(n=n, density=0.7)
        args = problem.args | {"width": float(width), "height": float(height)}
        run = _runner(problem.system, x0, args, t1=collisions, clock="jumps", every=float(every), blocks=2)
        return run, run()["events"]

    return make


def hard_disks(t1: float) -> Make:
    """Four hard disks; the work is counted in collisions."""

    def make():
        problem = lh.zoo.hard_disks(n=4, density=0.7)
        start, every = problems.DISKS_START, problems.DISKS_EVERY
        run = _runner(problem.system, start, problem.args, t1=t1, method=problem.method, every=every)
        return run, run()["events"]

    return make
