"""lyapax: its problem object, fixed steps and diffrax's adaptive ones, the whole call under `jax.jit`."""

import dataclasses
import functools

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import lyapax  # noqa: E402
import numpy as np  # noqa: E402
from lyapax.adaptive import diffrax_adaptive_step  # noqa: E402
from lyapax.sweep import sweep_lyapunov_spectrum  # noqa: E402

from benchmarks.peers.adapters import Bound  # noqa: E402
from benchmarks.peers.workloads import Workload  # noqa: E402

TOLERANCES = (1e-6, 1e-9)


def spectrum(workload: Workload, problem, count: int, renorm_every: int):
    """The call as one compiled function of the start."""

    @jax.jit
    def exponents(start):
        begun = dataclasses.replace(problem, state0=start)
        k = workload.frame.shape[1]
        return lyapax.lyapunov_spectrum(begun, n_steps=count, k=k, renorm_every=renorm_every).exponents

    return exponents


def drawn(workload: Workload) -> jax.Array:
    """The columns that it begins with: drawn with seed 0."""
    return jnp.linalg.qr(jax.random.normal(jax.random.PRNGKey(0), workload.frame.shape, jnp.float64))[0]


def flow(workload: Workload) -> Bound:
    field, start, p = workload.field(jnp), jnp.array(workload.start), workload.p

    def rhs(x):
        return field(0.0, x, p)

    ladder = {f"{name} 1/{steps}": (name, steps) for name in ("rk4", "rk6") for steps in workload.steps}
    ladder |= {f"adaptive {rtol:.0e}": (diffrax_adaptive_step(rtol=rtol, atol=rtol), 1) for rtol in TOLERANCES}

    @functools.cache
    def compiled(setting, length):
        integrator, steps = setting
        problem = lyapax.ode_problem(rhs, start, workload.every / steps, integrator)
        return spectrum(workload, problem, round(length / workload.every) * steps, steps)

    return Bound(ladder, lambda setting, length: compiled(setting, length)(start), drawn(workload), typical=2)


def iterated(workload: Workload) -> Bound:
    rule, start = workload.field(jnp), jnp.array(workload.start)
    problem = lyapax.ODEProblem(lambda x: rule(0, x, workload.p), start, 1.0)
    compiled = functools.cache(lambda every, length: spectrum(workload, problem, length, every))
    ladder = {"exact, QR every 5": 5}
    return Bound(ladder, lambda every, length: compiled(every, round(length))(start), drawn(workload))


def flow_sweep(workload: Workload) -> Bound:
    """Its sweep, by `jax.vmap`."""
    field, start, k = workload.field(jnp), jnp.array(workload.start), workload.frame.shape[1]

    @functools.cache
    def compiled(setting):
        name, steps = setting
        dt = workload.every / steps

        def step(x, p):
            return lyapax.ode_step(lambda x: field(0.0, x, (*workload.parameters, p["last"])), dt, name)(x)

        how = {"dt": dt, "n_steps": round(workload.sweep.t1 / dt), "renorm_every": steps, "k": k}
        return jax.jit(lambda values: sweep_lyapunov_spectrum(step, start, {"last": values}, **how).exponents)

    def run(setting, count):
        return np.ravel(compiled(setting)(workload.sweep.values(count)))

    ladder = {f"{name} 1/{steps}": (name, steps) for name in ("rk4", "rk6") for steps in workload.steps}
    return Bound(ladder, run, drawn(workload), typical=2)


KINDS = {"flow": flow, "map": iterated, "flow_sweep": flow_sweep}
