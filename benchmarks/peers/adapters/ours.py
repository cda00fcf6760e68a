"""This package, by its public interface."""

from collections.abc import Callable

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import lyaphybrid as lh  # noqa: E402
from benchmarks.peers.adapters import Bound  # noqa: E402
from benchmarks.peers.workloads import Workload  # noqa: E402

TOLERANCES = {"dopri5": (1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10), "dop853": (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)}
SCHEMES = ("ABA864", "SRKN14a")
IMPLICIT = {"esdirk54b": lambda rtol: lh.ESDIRK("esdirk54b", rtol), "radau": lambda rtol: lh.RadauIIA(rtol)}
TYPICAL = "dopri5 1e-08"


def adaptive() -> dict[str, dict]:
    """Settings with error control."""
    return {
        f"{tableau} {rtol:.0e}": {"method": lh.RungeKutta(tableau, rtol=rtol, atol=1e-2 * rtol)}
        for tableau, tolerances in TOLERANCES.items()
        for rtol in tolerances
    }


def fixed(workload: Workload, name: str, method) -> dict[str, dict]:
    """Fixed steps, with QR after as many as the others have."""
    steps, every = workload.steps, workload.every
    return {f"{name} 1/{count}": {"method": method(every / count), "every": count} for count in steps}


def runge_kutta(workload: Workload) -> dict[str, dict]:
    return adaptive() | fixed(workload, "rk4", lambda dt: lh.RungeKutta("rk4", dt=dt))


def bound(system, workload: Workload, ladder, typical: str = TYPICAL) -> Bound:
    start, frame, args = jnp.array(workload.start), jnp.array(workload.frame), workload.p

    def run(how, length):
        # steps end with blocks: 64 of them in the short length would make its error smaller than that of a long run
        how = how | {"blocks": 2 if length <= workload.short else 64, "k": frame.shape[1], "frame": frame}
        return lh.lyapunov_spectrum(system, start, args, t1=length, **how).exponents

    return Bound(ladder, run, typical=list(ladder).index(typical), system=system)


def flow(workload: Workload) -> Bound:
    """Runge–Kutta; where H = p²/2 + V(q) is known, symplectic schemes too."""
    field = workload.field(jnp)
    ladder = runge_kutta(workload)
    if workload.potential is None:
        return bound(lh.Flow(field), workload, ladder)
    for scheme in SCHEMES:
        ladder |= fixed(workload, scheme, lambda dt, scheme=scheme: lh.Symplectic(scheme, dt=dt))
    system = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, workload.potential(jnp))
    return bound(system, workload, ladder)


def stiff(workload: Workload) -> Bound:
    tolerances = (1e-3, 1e-4, 1e-6, 1e-8, 1e-10)
    ladder = {f"{name} {rtol:.0e}": {"method": make(rtol)} for name, make in IMPLICIT.items() for rtol in tolerances}
    return bound(lh.Flow(workload.field(jnp)), workload, ladder, "esdirk54b 1e-06")


def iterated(workload: Workload) -> Bound:
    return bound(lh.Map(workload.field(jnp)), workload, {"exact": {}, "exact, QR every 5": {"every": 5}}, "exact")


def impact(workload: Workload) -> Bound:
    reset = jnp.array(workload.event.reset)

    def gap(t, x, args):
        return -x[0]

    def rebound(t, x, args):
        return reset * x

    return bound(lh.Hybrid(workload.field(jnp), [lh.Transition(gap, rebound)]), workload, runge_kutta(workload))


def friction(workload: Workload) -> Bound:
    rates = workload.field(jnp)
    sides = [lambda t, x, args, sign=sign: rates(t, x, (*args[:-1], sign)) for sign in (1.0, -1.0)]
    return bound(lh.filippov(*sides, lambda t, x, args: x[1]), workload, runge_kutta(workload))


def disks(workload: Workload) -> Bound:
    problem = lh.zoo.hard_disks(n=4, density=0.7)
    start, frame = jnp.array(workload.start), jnp.array(workload.frame)

    def run(how, length):
        return lh.lyapunov_spectrum(problem.system, start, problem.args, t1=length, frame=frame, **how).exponents

    return Bound({"exact": {"method": problem.method}}, run)


def swept(one) -> Callable[[Workload], Bound]:
    """`lh.sweep` over the last parameter, by the system and the methods of a single run."""

    def swept(workload: Workload) -> Bound:
        single, start, frame = one(workload), jnp.array(workload.start), jnp.array(workload.frame)

        def point(how):
            def run(args):
                p, how_long = (*workload.parameters, args["last"]), {"t1": workload.sweep.t1, "blocks": 2}
                return lh.lyapunov_spectrum(single.system, start, p, frame=frame, **how_long, **how)

            return run

        def run(point, count):
            values = workload.sweep.values(count)
            found = lh.sweep(point, {"last": values}, args={"last": workload.last}, progress=False)
            return found["exponents"].values.ravel()

        return single._replace(ladder={name: point(how) for name, how in single.ladder.items()}, run=run)

    return swept


KINDS = {
    "flow": flow,
    "map": iterated,
    "stiff": stiff,
    "impact": impact,
    "friction": friction,
    "disks": disks,
    "flow_sweep": swept(flow),
    "impact_sweep": swept(impact),
}
