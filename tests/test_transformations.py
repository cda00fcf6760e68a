"""The same numbers under jit and vmap as without; derivatives as central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

PROBLEM = lh.zoo.impact_oscillator()
OMEGAS = jnp.array([2.0, 2.8, 1e-3])  # the last one hardly meets the wall within the run


def exponents(omega, t1=30.0):
    """Exponents of a short run of the impact oscillator."""
    args = {**PROBLEM.args, "omega": omega}
    run = lh.lyapunov_spectrum(PROBLEM.system, PROBLEM.x0, args, t1=t1, blocks=8, throw=False)
    return run.exponents, run.status_code, run.jumps


def end(omega):
    """The state after a few impacts."""
    return lh.trajectory(PROBLEM.system, PROBLEM.x0, {**PROBLEM.args, "omega": omega}, t1=6.0, n=1, throw=False).x[-1]


def test_jit_equals_eager():
    """The driver's many calls and the one traced call do the same arithmetic."""
    eager, _, _ = exponents(OMEGAS[1])
    traced, _, _ = jax.jit(exponents)(OMEGAS[1])
    np.testing.assert_allclose(traced, eager, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_vmap_equals_a_loop_over_lanes_with_different_numbers_of_events():
    """Lanes that wait for others are not disturbed."""
    batch, codes, jumps = jax.vmap(exponents)(OMEGAS)
    single = [exponents(omega) for omega in OMEGAS]
    np.testing.assert_allclose(batch, np.array([s[0] for s in single]), atol=1e-11)
    assert [int(c) for c in codes] == [int(s[1]) for s in single]
    assert len({int(j) for j in jumps}) == len(OMEGAS)
    assert [int(j) for j in jumps] == [int(s[2]) for s in single]


def test_derivatives_across_impacts_are_central_differences():
    """The event's time depends on the parameter: the polish carries that derivative."""
    h, omega = 1e-6, OMEGAS[1]
    _, tangent = jax.jvp(end, (omega,), (jnp.ones(()),))
    np.testing.assert_allclose(tangent, (end(omega + h) - end(omega - h)) / (2 * h), rtol=1e-6)


def test_derivatives_of_exponents_of_a_short_run():
    """QR, saltation and event times are all differentiable."""
    h, omega = 1e-6, OMEGAS[1]

    def short(omega):
        return exponents(omega, t1=6.0)[0]

    _, tangent = jax.jvp(short, (omega,), (jnp.ones(()),))
    np.testing.assert_allclose(tangent, (short(omega + h) - short(omega - h)) / (2 * h), rtol=1e-5)


def test_numbers_may_change_without_compiling_again():
    """Numbers are data: args, x0, t0, t1 and tolerances."""
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, *_, **__: compiled.append(name) if name.endswith("backend_compile_duration") else None
    )
    system = lh.Flow(lambda t, x, a: -a * x)
    for a, t1, rtol in ((1.0, 2.0, 1e-8), (1.5, 3.0, 1e-9)):
        before = len(compiled)
        lh.lyapunov_spectrum(system, [1.0 + a], a, t1=t1, t0=a, blocks=4, method=lh.RungeKutta(rtol=rtol))
    assert len(compiled) == before


def test_several_starts_are_several_runs():
    """x0 of shape (m, n)."""
    starts = jnp.array([[0.1, 0.1], [0.2, 0.1], [-0.3, 0.2]])
    henon = lh.zoo.henon_map()
    together = lh.lyapunov_spectrum(henon.system, starts, henon.args, t1=2000)
    alone = [lh.lyapunov_spectrum(henon.system, x, henon.args, t1=2000).exponents for x in starts]
    np.testing.assert_allclose(together.replicates, np.array(alone), atol=1e-12)
    np.testing.assert_allclose(together.exponents, np.mean(alone, axis=0), atol=1e-12)
    assert together.error_kind == "replicates"
