"""diffrax: an outer scan over `diffeqsolve(event=…)`, see tests/support/diffrax_events.py."""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

from benchmarks import rivals  # noqa: E402
from benchmarks.peers.adapters import Bound  # noqa: E402
from benchmarks.peers.workloads import Workload  # noqa: E402

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)


def impact(workload: Workload) -> Bound:
    second, field = rivals.second_implementation(), workload.field(jnp)
    reset = jnp.array(workload.event.reset)

    def gap(t, x, args):
        return -x[0]

    def rebound(t, x, args):
        return reset * x

    def run(rtol, length):
        options = second.Options(rtol, 1e-2 * rtol, root_finder=second.BISECTION)
        system = field, gap, rebound, workload.start, workload.p
        return second.diffrax_spectrum(*system, t1=length, columns=workload.frame, options=options).exponents

    return Bound({f"dopri5 {rtol:.0e}": rtol for rtol in TOLERANCES}, run, typical=2)


KINDS = {"impact": impact}
