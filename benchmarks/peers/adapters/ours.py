"""This package, by its public interface."""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import lyaphybrid as lh  # noqa: E402
from benchmarks.peers.adapters import Bound  # noqa: E402
from benchmarks.peers.adapters.stacking import stacked  # noqa: E402
from benchmarks.peers.workloads import Workload  # noqa: E402

TOLERANCES = {"dopri5": (1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10), "dop853": (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)}
TYPICAL = "dopri5 1e-08"


def methods(workload: Workload) -> dict[str, dict]:
    """Error control, and fixed steps with QR after as many as the others have."""
    ladder = {
        f"{tableau} {rtol:.0e}": {"method": lh.RungeKutta(tableau, rtol=rtol, atol=1e-2 * rtol)}
        for tableau, tolerances in TOLERANCES.items()
        for rtol in tolerances
    }
    fixed = {
        f"rk4 1/{steps}": {"method": lh.RungeKutta("rk4", dt=workload.every / steps), "every": steps}
        for steps in workload.steps
    }
    return ladder | fixed


def bound(system, workload: Workload, ladder) -> Bound:
    start, frame, args = jnp.array(workload.start), jnp.array(workload.frame), workload.parameters

    def run(how, length):
        return lh.lyapunov_spectrum(system, start, args, t1=length, frame=frame, **how).exponents

    return Bound(ladder, run, typical=list(ladder).index(TYPICAL) if TYPICAL in ladder else 0)


def flow(workload: Workload) -> Bound:
    return bound(lh.Flow(stacked(workload.formula)), workload, methods(workload))


def iterated(workload: Workload) -> Bound:
    return bound(lh.Map(stacked(workload.formula)), workload, {"exact": {}, "exact, QR every 10": {"every": 10}})


def impact(workload: Workload) -> Bound:
    def gap(t, x, args):
        return -x[0]

    def rebound(t, x, args):
        return jnp.stack([x[0], -args[2] * x[1]])

    return bound(lh.Hybrid(stacked(workload.formula), [lh.Transition(gap, rebound)]), workload, methods(workload))


KINDS = {"flow": flow, "map": iterated, "impact": impact}
