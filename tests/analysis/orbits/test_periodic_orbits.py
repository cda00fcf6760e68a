"""Periodic orbits, their multipliers and return maps, against closed forms and independent values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import STATUS, zoo
from lyaphybrid.analysis.orbits.periods import depends_on_time

FORCED = 2 * np.pi / 0.666


def van_der_pol(t, x, mu):
    return jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])


def driven(t, x, args):
    return jnp.stack([x[1], args["amplitude"] * jnp.cos(2 * t) - x[0] - 0.3 * x[1]])


def normal_form(t, x, rate):
    """r' = r − r³, φ' = 2, z' = −rate z: a circle with multipliers 1, e^(−2π), e^(−rate π)."""
    radius = x[0] ** 2 + x[1] ** 2
    return jnp.stack([x[0] - 2 * x[1] - x[0] * radius, x[1] + 2 * x[0] - x[1] * radius, -rate * x[2]])


CIRCLE = lh.Flow(normal_form)


# Smooth flows and maps.


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 3])
def test_a_limit_cycle_of_unknown_period(segments):
    orbit = lh.floquet(CIRCLE, [0.9, 0.1, 0.3], 0.5, segments=segments)
    exact = np.exp(np.pi * np.array([0.0, -0.5, -2.0]))
    assert orbit.period == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_allclose(orbit.multipliers, exact, rtol=1e-9)
    np.testing.assert_allclose(orbit.exponents, [0.0, -0.5, -2.0], atol=1e-9)
    assert orbit.stable
    assert orbit.residual < 1e-12
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(orbit.monodromy)), np.sort(exact), rtol=1e-9)


def test_an_unstable_cycle_is_found_and_called_so():
    orbit = lh.floquet(CIRCLE, [1.0, 0.0, 0.0], -0.5)
    np.testing.assert_allclose(orbit.exponents, [0.5, 0.0, -2.0], atol=1e-9)
    assert not orbit.stable
    assert "not asymptotically stable" in str(orbit)


@pytest.mark.parametrize("period", [np.pi, lambda args: np.pi])
def test_a_forced_oscillator(period):
    """Its response is known in closed form; the multipliers are those of the free oscillator."""
    orbit = lh.floquet(lh.Flow(driven), [0.0, 0.0], {"amplitude": 1.0}, period=period, t0=0.4)
    response = 1.0 / (1 - 4 + 0.6j)
    x = (response * np.exp(0.8j)).real, (2j * response * np.exp(0.8j)).real
    np.testing.assert_allclose(orbit.x0, x, atol=1e-11)
    roots = np.roots([1, 0.3, 1])
    np.testing.assert_allclose(orbit.exponents, -0.15, atol=1e-10)
    wanted = np.exp(np.pi * roots)
    found = np.asarray(orbit.multipliers)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(wanted), atol=1e-11)


def test_a_cycle_of_a_map():
    """The logistic map at r = 3.2 has the 2-cycle ((r + 1) ± √((r − 3)(r + 1)))/2r, multiplier 4 + 2r − r²."""
    r = 3.2
    orbit = lh.floquet(lh.Map(lambda n, x, r: r * x * (1 - x)), [0.5], r, period=2)
    point = (r + 1 - np.sqrt((r - 3) * (r + 1))) / (2 * r)
    assert float(orbit.x0[0]) == pytest.approx(point, abs=1e-13)
    assert complex(orbit.multipliers[0]) == pytest.approx(4 + 2 * r - r**2, abs=1e-12)
    assert float(orbit.exponents[0]) == pytest.approx(np.log(abs(4 + 2 * r - r**2)) / 2, abs=1e-12)


# What cannot be found.


def test_a_system_that_depends_on_time_needs_a_period():
    with pytest.raises(ValueError, match="depends on time: give period"):
        lh.floquet(lh.Flow(driven), [0.0, 0.0], {"amplitude": 1.0})


def test_a_forcing_of_amplitude_zero_is_no_dependence_on_time():
    x = jnp.array([1.0, 0.5])
    assert depends_on_time(lh.Flow(driven), x, {"amplitude": 1.0})
    assert not depends_on_time(lh.Flow(driven), x, {"amplitude": 0.0})
    assert not depends_on_time(lh.Flow(van_der_pol), x, 1.0)


def test_no_return_and_no_convergence_are_errors_that_say_what_to_do():
    away = lh.Flow(lambda t, x, args: jnp.ones_like(x) + 0 * x)
    with pytest.raises(lh.NoPeriodicOrbitError, match="did not come back"):
        lh.floquet(away, [0.0, 1.0])
    with pytest.raises(lh.NoPeriodicOrbitError, match="stands at a residual") as caught:
        lh.floquet(CIRCLE, [0.5, 0.1, 0.3], 0.5, period=2.0, max_iterations=1)
    assert caught.value.result.residual > 1e-9
    assert caught.value.result.status is STATUS.no_orbit


def test_a_status_says_whether_there_is_an_orbit_and_how_the_motion_failed():
    assert lh.floquet(CIRCLE, [1.0, 0.1, 0.3], 0.5, period=2.0).status is STATUS.ok
    stopped = lh.floquet(CIRCLE, [0.5, 0.1, 0.3], 0.5, period=2.0, max_iterations=1, throw=False)
    assert stopped.residual > 1e-9
    assert stopped.status is STATUS.no_orbit
    assert str(stopped).startswith("No periodic orbit, T = 2")
    assert "status no_orbit: no periodic orbit was found" in str(stopped)
    away = lh.floquet(lh.Flow(lambda t, x, args: jnp.ones_like(x)), [0.0, 1.0], throw=False)
    assert away.status is STATUS.no_orbit
    escaping = lh.floquet(lh.Flow(lambda t, x, args: x**2), [1.0, 0.5], throw=False)
    assert escaping.status is STATUS.nonfinite
    assert np.isnan(escaping.period)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"segments": 0}, "segments must be an integer of at least 1"),
        ({"period": -1.0}, "period must be positive"),
        ({"x0": [[1.0, 0.0, 0.0]]}, r"x0 must have shape \(n,\)"),
    ],
)
def test_bad_arguments(arguments, says):
    keywords = {"x0": [1.0, 0.0, 0.0], "args": 0.5} | arguments
    with pytest.raises(ValueError, match=says):
        lh.floquet(CIRCLE, **keywords)


# Jumps.


@pytest.mark.slow
def test_rimless_wheel(nonsmooth):
    known, problem = nonsmooth["rimless a=pi/8,gam=0.2"], zoo.rimless_wheel()
    orbit = lh.floquet(problem.system, problem.x0, problem.args)
    assert orbit.period == pytest.approx(known["period"], abs=1e-9)
    np.testing.assert_allclose(orbit.multipliers, known["multipliers"], atol=1e-9)
    np.testing.assert_allclose(orbit.exponents, known["exponents"], atol=1e-9)
    np.testing.assert_allclose(orbit.x0, known["ic"], atol=1e-9)
    stride = lh.return_map(problem.system)
    np.testing.assert_allclose(stride.rule(0.0, problem.x0, problem.args), problem.x0, atol=1e-11)
    multipliers = np.linalg.eigvals(jax.jacfwd(lambda x: stride.rule(0.0, x, problem.args))(problem.x0))
    np.testing.assert_allclose(np.sort(multipliers), [0.0, 0.5], atol=1e-9)


@pytest.mark.slow
def test_simplest_walker(nonsmooth):
    known, problem = nonsmooth["simplest walker long gamma=0.009"], zoo.simplest_walker()
    orbit = lh.floquet(problem.system, problem.x0, problem.args)
    wanted = [complex(*mu) for mu in known["multipliers"]]
    assert orbit.period == pytest.approx(known["period"], abs=1e-9)
    np.testing.assert_allclose(_sorted(orbit.multipliers), _sorted(wanted), atol=1e-7)
    assert orbit.multipliers[3] == 0.0  # the saltation matrix has rank 3 of 4
    assert np.isneginf(orbit.exponents[3])
    stride = lh.return_map(problem.system)
    derivative = jax.jacfwd(lambda x: stride.rule(0.0, x, problem.args))(orbit.x0)
    found, less_the_trivial = _sorted(np.linalg.eigvals(derivative)), _sorted([0.0, 0.0, *wanted[1:3]])
    np.testing.assert_allclose(found, less_the_trivial, atol=1e-7)


def _sorted(values):
    return np.sort_complex(np.round(np.asarray(values, complex), 12))


@pytest.mark.slow
def test_return_maps_of_systems_that_depend_on_time_carry_the_time():
    problem = zoo.impact_oscillator(omega=2.0)
    hits = lh.return_map(problem.system, with_time=True)
    start = jnp.array([0.0, -0.5, 0.0])
    derivative = jax.jacfwd(lambda x: hits.rule(0.0, x, problem.args))(start)
    for i in (1, 2):
        step = 1e-6 * jnp.eye(3)[i]
        ends = hits.rule(0.0, start + step, problem.args), hits.rule(0.0, start - step, problem.args)
        np.testing.assert_allclose(derivative[:, i], (ends[0] - ends[1]) / 2e-6, atol=1e-8)
    with pytest.raises(ValueError, match="with_time=True"):
        lh.return_map(problem.system).rule(0.0, start[:2], problem.args)


@pytest.mark.slow
def test_the_map_of_a_clock_is_stroboscopic():
    """x' = −x, kicked by 1 each unit of time: x⁺ = x/e + 1."""
    kicked = lh.Hybrid(lambda t, x, args: -x, lh.Transition(every=1.0, reset=lambda t, x, args: x + 1))
    strobe = lh.return_map(kicked)
    assert float(strobe.rule(3.0, jnp.array([0.7]), None)[0]) == pytest.approx(0.7 / np.e + 1, abs=1e-12)
    spectrum = lh.lyapunov_spectrum(strobe, [0.7], t1=20)
    assert float(spectrum.exponents[0]) == pytest.approx(-1.0, abs=1e-11)


@pytest.mark.slow
def test_a_transition_that_never_fires_again_gives_no_iterate():
    once = lh.Hybrid(lambda t, x, args: jnp.ones_like(x), lh.Transition(lambda t, x, args: 1 - x[0]))
    assert np.isnan(lh.return_map(once).rule(0.0, jnp.array([2.0]), None)).all()


def test_return_maps_need_to_know_the_mode():
    fields = {"up": lambda t, x, args: x, "down": lambda t, x, args: -x}
    target = lambda t, x, args: jnp.asarray(0)  # noqa: E731
    system = lh.Hybrid(fields, lh.Transition(lambda t, x, args: x[0], target=target))
    with pytest.raises(ValueError, match="the mode may be any of"):
        lh.return_map(system)
    with pytest.raises(ValueError, match="index from 0 to 0"):
        lh.return_map(system, 1)


# Dry friction and relays.


@pytest.mark.slow
def test_a_block_on_a_plate():
    problem = zoo.block_on_plate()
    orbit = lh.floquet(problem.system, problem.x0, problem.args, period=2 * np.pi)
    np.testing.assert_allclose(orbit.exponents, [0.0, -0.22551868844396014], atol=1e-10)
    sticking = zoo.block_on_plate(alpha=0.6)
    orbit = lh.floquet(sticking.system, sticking.x0, sticking.args, period=2 * np.pi)
    assert orbit.multipliers[1] == 0.0
    assert np.isneginf(orbit.exponents[1])
    assert orbit.jumps == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fu_fig1", "fu_fig2"])
def test_the_pendulum_of_fu(nonsmooth, name):
    known = nonsmooth[name]
    problem = zoo.friction_pendulum(beta=known["params"]["beta"], alpha=known["params"]["alpha"])
    # From far away too: both orbits attract nearly everything.
    orbit = lh.floquet(problem.system, [0.3, 0.1], problem.args, period=FORCED, transient=60 * FORCED)
    wanted = np.array([float(value) for value in known["exponents"]])
    np.testing.assert_allclose(orbit.exponents, wanted, atol=1e-9)
    np.testing.assert_allclose(orbit.x0, known["ic"], atol=1e-9)
    assert orbit.stable
    if name == "fu_fig2":
        assert complex(orbit.multipliers[0]) == pytest.approx(known["multipliers"][0], abs=1e-9)


@pytest.mark.slow
def test_a_relay_in_a_loop(nonsmooth):
    known, problem = nonsmooth["relay 1/(s+1)^3, u=-sgn y"], zoo.relay_feedback()
    orbit = lh.floquet(problem.system, problem.x0, problem.args)
    assert orbit.period == pytest.approx(2 * known["half_period"], abs=1e-9)
    np.testing.assert_allclose(orbit.exponents, known["exponents"], atol=1e-9)
    squared = [complex(*mu) ** 2 for mu in known["multipliers_half"]]
    np.testing.assert_allclose(_sorted(orbit.multipliers), _sorted(squared), atol=1e-9)


@pytest.mark.slow
def test_a_mass_on_a_belt(nonsmooth):
    known, problem = nonsmooth["Leine belt stick-slip (unforced)"], zoo.stick_slip_belt()
    orbit = lh.floquet(problem.system, problem.x0, problem.args)
    assert orbit.period == pytest.approx(known["period"], abs=1e-9)
    np.testing.assert_allclose(orbit.multipliers, [1.0, 0.0], atol=1e-9)
    assert np.isneginf(orbit.exponents[1])


@pytest.mark.slow
def test_other_orbits_of_a_kind_compile_nothing_again():
    """What differs between two orbits, the period among it, is traced."""
    traced = []

    @jax.jit
    def turns(orbit):
        traced.append(1)
        return 10.0 / orbit.period, orbit.residual

    for omega in (2.0, 3.0):
        system = lh.Flow(lambda t, x, w: jnp.array([w * x[1], -w * x[0]]) * 1.0 + (1 - x @ x) * x)
        orbit = lh.floquet(system, [1.0, 0.1], omega)
        np.testing.assert_allclose(turns(orbit)[0], 10 * omega / (2 * np.pi), rtol=1e-8)
    assert len(traced) == 1


@pytest.mark.parametrize("x0", [[0.0, 0.0], [1e-17, 3e-18]])
def test_an_equilibrium_has_no_period(x0):
    """At rest nothing comes back; next to it the motion takes no longer to tell than elsewhere."""
    sink = lh.Flow(lambda t, x, args: -x * jnp.array([1.0, 2.0]))
    with pytest.raises(lh.NoPeriodicOrbitError, match="at rest" if x0[0] == 0 else "did not come back"):
        lh.floquet(sink, x0)


@pytest.mark.parametrize("transient", [0.0, 300.0, 3000.0])
def test_a_motion_that_has_come_to_rest_has_no_period(transient):
    """A focus not at zero, a spike that is not reached; and a node at zero, where the state underflows at last."""
    focus = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[0] ** 2 - 0.25 - x[1], 0.3 * (0.1 * x[0] - x[1])]),
        lh.Transition(lambda t, x, args: 30.0 - x[0], lambda t, x, args: x),
    )
    node = lh.Flow(lambda t, x, args: -0.5 * x)
    for system, start in ((focus, [-0.3, 0.0]), (node, [1.0])):
        with pytest.raises(lh.NoPeriodicOrbitError, match="at rest|did not come back"):
            lh.floquet(system, start, transient=transient)


@pytest.mark.slow
def test_an_orbit_beyond_a_guard_says_so():
    """A switch that is to open where the current is above a ramp; the start is above it, and so is the whole orbit."""
    up = lambda t, x, args: jnp.stack([40.0 - 10 * x[0], 1.0 + 0 * x[1]])  # noqa: E731
    down = lambda t, x, args: jnp.stack([-10 * x[0], 1.0 + 0 * x[1]])  # noqa: E731
    ramp = lh.Transition(lambda t, x, args: x[0] - 1.5 - x[1], source="on", target="off", direction=+1)
    tick = lh.Transition(every=1.0, reset=lambda t, x, args: x.at[1].set(0.0))
    closed = lh.Transition(every=1.0, reset=lambda t, x, args: x.at[1].set(0.0), target="on")
    stuck = lh.floquet(
        lh.Hybrid({"on": up, "off": down}, [ramp, tick]), [3.0, 0.0], period=1.0, mode="on", transient=20
    )
    assert stuck.notes == {"beyond_guard"}
    assert "never fires" in str(stuck)
    works = lh.floquet(lh.Hybrid({"on": up, "off": down}, [ramp, closed]), [0.5, 0.0], period=1.0, mode="on")
    assert works.notes == frozenset()
    assert works.jumps == 2
