"""chaotax: the spectrum of a step, which is RK4 written out, QR after each."""

import functools

import jax

jax.config.update("jax_enable_x64", True)

import chaotax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

from benchmarks.peers.adapters import Bound  # noqa: E402
from benchmarks.peers.workloads import Workload  # noqa: E402


def bound(workload: Workload, ladder, stepper, count) -> Bound:
    """`stepper` and `count` of a setting: the step, and how many there are in a length."""
    start, rows = jnp.array(workload.start), jnp.array(workload.frame.T)

    @functools.cache
    def compiled(setting, length):
        steps = count(setting, length)
        how = {"warmup_steps": 0, "discard_steps": 0, "num_exponents": len(rows)}
        spectrum = chaotax.lyapunov_spectrum(stepper(setting), rollout_steps=steps, dt=length / steps, **how)

        @jax.jit
        def exponents(start, rows):
            with jax.ensure_compile_time_eval():  # chaotax 0.0.1 multiplies the shape by JAX
                return spectrum(start, rows)

        return exponents

    return Bound(ladder, lambda setting, length: compiled(setting, length)(start, rows), typical=len(ladder) // 2)


def flow(workload: Workload) -> Bound:
    rates = workload.field(jnp)

    def field(x):
        return rates(0.0, x, workload.p)

    def stepper(steps):
        h = workload.every / steps

        def step(x):
            one = field(x)
            two = field(x + h / 2 * one)
            three = field(x + h / 2 * two)
            return x + h / 6 * (one + 2 * two + 2 * three + field(x + h * three))

        return step

    ladder = {f"rk4 1/{steps}": steps for steps in workload.steps}
    return bound(workload, ladder, stepper, lambda steps, length: round(length / workload.every) * steps)


def iterated(workload: Workload) -> Bound:
    rule = workload.field(jnp)

    def step(x):
        return rule(0, x, workload.p)

    return bound(workload, {"exact": 1}, lambda _: step, lambda _, length: round(length))


KINDS = {"flow": flow, "map": iterated}
