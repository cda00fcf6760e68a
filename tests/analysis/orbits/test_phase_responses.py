"""Phase responses of cycles with jumps: closed forms, and kicks of whole motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo


def clock(t, x, a):
    return x * (1 - x @ x) + jnp.stack([-x[1], x[0]])


CLOCK = lh.Flow(clock, names=("x", "y"))
LEAKY = lh.Hybrid(
    lambda t, v, args: args - v, lh.Transition(lambda t, v, args: 1.0 - v[0], lambda t, v, args: 0 * v), names=("v",)
)


def with_a_wall(t, x, args):
    return jnp.stack([x[1], 0.8 * (1 - x[0] ** 2) * x[1] - x[0]])


WALL = lh.Hybrid(
    with_a_wall,
    lh.Transition(lambda t, x, args: x[0] + 1.2, lambda t, x, args: jnp.stack([x[0], -0.7 * x[1]])),
    names=("x", "v"),
)


def glass() -> lh.Hybrid:
    """A Glass network: three genes that repress each other in a ring, each on or off, x' = −x ± 1."""
    names = [a + b + c for a in "+-" for b in "+-" for c in "+-"]

    def field(name):
        signs = np.array([1.0 if one == "+" else -1.0 for one in name])
        return lambda t, x, args: -x - np.roll(signs, 1) * args

    def flip(name, i):
        return name[:i] + ("-" if name[i] == "+" else "+") + name[i + 1 :]

    transitions = [
        lh.Transition(
            lambda t, x, args, i=i: x[i], source=name, target=flip(name, i), direction=-1 if name[i] == "+" else 1
        )
        for name in names
        for i in range(3)
    ]
    return lh.Hybrid({name: field(name) for name in names}, transitions)


def relay():
    """An integrator chain with a relay with hysteresis, x''' …: two modes, switched where x crosses ∓0.3."""

    def side(u):
        return lambda t, x, args: jnp.stack([x[1], -x[0] - 1.5 * x[1] - u])

    up = lh.Transition(lambda t, x, args: x[0] - 0.3, source="low", target="high", direction=1)
    down = lh.Transition(lambda t, x, args: x[0] + 0.3, source="high", target="low", direction=-1)
    return lh.Hybrid({"high": side(1.0), "low": side(-1.0)}, [up, down])


PENDULUM = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
WALKER, BELT, FORCED = zoo.simplest_walker(), zoo.stick_slip_belt(), zoo.impact_oscillator()
CYCLES = {
    "smooth": (CLOCK, [1.0, 0.2], None, {}),
    "neuron": (LEAKY, [0.5], 1.7, {}),
    "impact": (WALL, [1.0, 0.5], None, {"transient": 60.0}),
    "relay": (relay(), [0.0, 0.5], None, {"mode": "low", "transient": 60.0}),
    "Glass": (glass(), [0.6, -0.3, 0.2], 1.0, {"mode": "+-+", "transient": 60.0}),
    "stick-slip": (BELT.system, BELT.x0, BELT.args, {"mode": BELT.mode, "transient": 60.0}),
    "walker": (WALKER.system, WALKER.x0, WALKER.args, {"mode": WALKER.mode, "transient": 40.0}),
}


def found_of(name, phases=40):
    system, x0, args, how = CYCLES[name]
    return lh.phase_response(system, x0, args, phases=phases, **how)


@pytest.mark.slow
def test_a_clock_in_closed_form():
    found = found_of("smooth", phases=16)
    x, y = found.x.T
    assert_allclose(found.period, 2 * np.pi, rtol=1e-13)
    assert_allclose(found.response, np.stack([-y, x], axis=1), rtol=0, atol=1e-12)
    assert_allclose(found.multipliers, [np.exp(-4 * np.pi)], rtol=1e-9)
    radial = found.isostables[:, :, 0] / found.isostables[0, 0, 0] * x[0]
    assert_allclose(radial, found.x, rtol=0, atol=1e-8)
    kick = np.array([0.3, -0.2])
    exact = np.angle((x + 0.3 + 1j * (y - 0.2)) / (x + 1j * y))
    assert_allclose(found.finite(kick), exact, rtol=0, atol=1e-9)
    assert_allclose(found.finite([kick, -kick], at=[3, 3])[0], exact[3], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_neuron_in_closed_form():
    found = found_of("neuron")
    assert_allclose(found.period, np.log(1.7 / 0.7), rtol=1e-12)
    assert_allclose(found.response, 1 / (1.7 - found.x), rtol=1e-10)
    assert found.multipliers.shape == (0,)
    early = found.x[:, 0] < 0.9
    exact = np.log((1.7 - found.x) / (1.6 - found.x))[:, 0]
    assert_allclose(found.finite([0.1])[early], exact[early], rtol=0, atol=1e-9)
    behind_reset = np.log((1.7 - found.x) / (1.7 - 1e-4))[:, 0]  # each phase is kicked to just behind the reset at 0
    apart = found.finite(1e-4 - found.x) - behind_reset
    assert_allclose(apart - found.period * np.round(apart / found.period), 0.0, atol=1e-9)


@pytest.mark.parametrize("current", [np.float64(2.0), jnp.asarray(2.0)])
def test_parameters_may_be_arrays(current):
    """A neuron's time from its reset to its threshold is ln 2; equinox must not warn of arrays that it sees."""
    neuron = lh.Hybrid(
        lambda t, v, args: args["I"] - v, lh.Transition(lambda t, v, args: 1.0 - v[0], lambda t, v, args: 0 * v)
    )
    assert_allclose(lh.phase_response(neuron, [0.5], {"I": current}, phases=4).period, np.log(2), rtol=1e-11)


@pytest.mark.slow_cases("Glass", "stick-slip", "walker", "relay", "impact", "neuron")
@pytest.mark.parametrize("name", CYCLES)
def test_the_flow_leads_ahead_by_its_time(name):
    found = found_of(name)
    velocities = [np.asarray(found._cycle.field(jnp.asarray(x), m)) for x, m in zip(found.x, found.mode, strict=True)]
    assert_allclose(np.sum(found.response * velocities, axis=1), 1.0, rtol=0, atol=1e-9)
    if found.multipliers.size:  # a kick along the flow excites nothing that decays
        along = np.einsum("kdm,kd->km", found.isostables, velocities)
        assert np.max(np.abs(along)) < 1e-6 * np.max(np.abs(found.isostables)) * np.max(np.abs(velocities))


@pytest.mark.slow
@pytest.mark.parametrize("name", CYCLES)
def test_small_kicks_of_whole_motions_agree(name):
    """Differences of sixth order, at phases from which no kick crosses a guard or leaves a surface."""
    found, system = found_of(name), CYCLES[name][0]
    n, d = found.x.shape
    free = [True] if isinstance(system, lh.Flow) else [project is None for project in system.tangent]
    far = [
        k
        for k in range(n)
        if free[found.mode[k]]
        and all(found.mode[(k + i) % n] == found.mode[k] for i in (-1, 1))
        and np.max(np.abs(found.x[(k + 1) % n] - found.x[k - 1])) < 0.5 * np.max(np.ptp(found.x, axis=0))
    ]
    size = (1.1e-4 if name == "walker" else 1e-3) * np.ptp(found.x, axis=0)
    for k in far[:: max(1, len(far) // 3)][:3]:
        for i in range(d):
            unit = np.zeros(d)
            unit[i] = size[i]
            each = (found.finite(m * unit, at=[k])[0] - found.finite(-m * unit, at=[k])[0] for m in (1, 2, 3))
            slope = np.dot([45, -9, 1], list(each)) / (60 * size[i])
            scale = np.max(np.abs(found.response[:, i]))
            assert abs(slope - found.response[k, i]) < 1e-8 * scale, (name, k, i, slope, found.response[k, i])


@pytest.mark.slow
def test_two_weakly_coupled_oscillators_lock_where_predicted():
    """Two impact oscillators, coupled through their positions: the whole motion ends at a predicted difference."""
    system, x0, args, how = CYCLES["impact"]
    found = lh.phase_response(system, x0, args, phases=400, **how)
    pull = lambda x, y, args: jnp.stack([0 * x[0], y[0] - x[0]])  # noqa: E731
    states = found.locked(pull)
    attracting = [shift for shift, stable in states if stable]
    strength = 0.01

    def both(t, x, args):
        one, two = x[:2], x[2:]
        return jnp.concatenate(
            [with_a_wall(t, one, args) + strength * pull(one, two, args),
             with_a_wall(t, two, args) + strength * pull(two, one, args)]
        )  # fmt: skip

    bounce = lambda i: lambda t, x, args: x.at[i + 1].multiply(-0.7)  # noqa: E731
    walls = [lh.Transition(lambda t, x, args, i=i: x[i] + 1.2, bounce(i)) for i in (0, 2)]
    start = np.concatenate([found.x[0], found.x[130]])
    events = lh.trajectory(lh.Hybrid(both, walls), start, t1=4000.0, n=1).events
    last = [float(np.asarray(events.t)[np.asarray(events.transition) == i][-1]) for i in (0, 1)]
    apart = (last[0] - last[1]) % found.period  # the second is ahead by this
    near = [abs((apart - one + found.period / 2) % found.period - found.period / 2) for one in attracting]
    assert min(near) < 0.02 * found.period, (apart, states)


def sheared(t, x, a):
    """r' = a r (1 − r²), φ' = 2 r²: the phase is (φ + 2/a ln r) / 2."""
    r2 = x @ x
    return jnp.stack([a * (1 - r2) * x[0] - 2 * r2 * x[1], 2 * r2 * x[0] + a * (1 - r2) * x[1]])


@pytest.mark.slow
@pytest.mark.parametrize(("a", "phases"), [(0.3, 4), (0.3, 50), (0.01, 50), (0.003, 8)])
def test_finite_kicks_under_strong_shear_and_slow_decay(a, phases):
    """In closed form: few phases, and multipliers up to exp(−2π a) = 0.98, which need 850 turns."""
    found = lh.phase_response(lh.Flow(sheared), [1.0001, 0.0], a, phases=phases)
    phase = lambda x: (np.arctan2(x[:, 1], x[:, 0]) + 2 / a * np.log(np.hypot(*x.T))) / 2  # noqa: E731
    kick = np.array([0.05, 0.0])
    apart = found.finite(kick) - (phase(found.x + kick) - phase(found.x))
    assert_allclose(apart - np.pi * np.round(apart / np.pi), 0.0, atol=1e-9)


@pytest.mark.parametrize("mu", [3.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_finite_kicks_of_a_relaxation_oscillation(mu):
    """Against the instants at which another integrator lets the kicked motion cross x = 0, six periods later."""
    system = lh.Flow(lambda t, x, mu: jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]))
    found = lh.phase_response(system, [2.0, 0.0], mu, transient=60.0)
    upwards = lambda t, y: y[0]  # noqa: E731
    upwards.direction = 1

    def crossing(x):
        field = lambda t, y: [y[1], mu * (1 - y[0] ** 2) * y[1] - y[0]]  # noqa: E731
        how = {"method": "DOP853" if mu < 9 else "LSODA", "rtol": 1e-11, "atol": 1e-13, "events": upwards}
        return scipy.integrate.solve_ivp(field, (0, 6 * found.period), x, **how).t_events[0][-1]

    at, kick = range(0, 200, 25), np.array([0.1, 0.0])
    ahead = found.finite(kick, at=at)
    apart = ahead - [crossing(found.x[i]) - crossing(found.x[i] + kick) for i in at]
    assert_allclose(apart - found.period * np.round(apart / found.period), 0.0, atol=1e-8)


@pytest.mark.slow
def test_an_even_interaction_function_locks_nowhere():
    clock_twice = lh.Flow(lambda t, x, a: x * (1 - x @ x) + 2 * jnp.stack([-x[1], x[0]]))
    found = lh.phase_response(clock_twice, [1.0, 0.1], phases=100)
    turned = lambda x, y, args: jnp.stack([-y[1], y[0]])  # noqa: E731
    assert_allclose(found.interaction(turned), np.cos(2 * found.t) / 2, atol=1e-13)
    with pytest.warns(UserWarning, match="interaction function is even"):
        assert found.locked(turned) == []
    # A small odd part beside a large even one counts: 1e-3 (y − x) has the Γ of 5e-4 sin 2Δ, and attracts at 0.
    both = lambda x, y, args: turned(x, y, args) + 1e-3 * (y - x)  # noqa: E731
    assert_allclose(found.locked(both), [(0.0, True), (found.period / 2, False)], atol=1e-9)


def filters(a):
    """The clock at twice its speed with two equal filters behind it, x3' = −x3/2 + a x4 + x/10, x4' = −x4/2 + y/5."""

    def field(t, x, args):
        own = x[:2] * (1 - x[:2] @ x[:2]) + 2 * jnp.stack([-x[1], x[0]])
        return jnp.concatenate([own, jnp.stack([-x[2] / 2 + a * x[3] + x[0] / 10, -x[3] / 2 + x[1] / 5])])

    return lh.phase_response(lh.Flow(field), [1.0, 0.0, 0.1, 0.1], phases=8, transient=5.0)


def test_equal_multipliers_have_isostables_of_a_basis():
    """ψ of the filters are their distances from what they show on the cycle, in closed form."""
    found = filters(0.0)
    assert_allclose(found.multipliers, np.exp(-np.pi * np.array([0.5, 0.5, 2.0])), rtol=1e-8)
    rows = found.isostables[:, :, :2]
    mixed = rows[:, 2:]  # (phases, 2, 2): orthogonal, the same at all phases
    assert_allclose(mixed, np.broadcast_to(mixed[0], mixed.shape), atol=1e-8)
    velocities = np.array([found._cycle.field(jnp.asarray(x), 0) for x in found.x])
    assert_allclose(np.einsum("kdm,kd->km", rows, velocities), 0.0, atol=1e-9)
    # ψ3 = x3 − Re(c e^{iφ}) with the angle φ and c = 0.1 / (1/2 + 2i).
    own = np.linalg.solve(mixed[0].T, rows[0].T)  # rows of ψ3 and ψ4
    circle = found.x[0, 0] + 1j * found.x[0, 1]
    tangent = np.array([-found.x[0, 1], found.x[0, 0]])
    c = np.array([0.1, -0.2j]) / (0.5 + 2j)
    assert_allclose(own[:, :2] @ tangent, -np.real(1j * c * circle), atol=1e-8)
    assert_allclose(own[:, 2:], np.eye(2), atol=1e-8)


@pytest.mark.parametrize("a", [1e-6, 1.0])
def test_a_jordan_block_has_no_isostables(a):
    with pytest.warns(UserWarning, match=r"nan for multipliers of size 0.20788, 0.20788: .*Jordan block"):
        found = filters(a)
    assert np.all(np.isnan(found.isostables[:, :, :2]))
    assert np.all(np.isfinite(found.isostables[:, :, 2]))
    assert "isostable responses are nan" in str(found)


@pytest.mark.slow
def test_a_thousand_phases_in_closed_form():
    found = lh.phase_response(LEAKY, [0.5], 1.7, phases=1000)
    assert_allclose(found.response, 1 / (1.7 - found.x), rtol=1e-10)


@pytest.mark.slow
def test_the_derivative_of_the_period_by_a_parameter():
    """dT/dp = −∫ Z · ∂f/∂p dt, the interaction function with ∂f/∂p at 0; against differences of periods."""
    system = lh.Flow(lambda t, x, mu: jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]))
    found, h = lh.phase_response(system, [2.0, 0.0], 1.0, phases=300), 1e-4
    pushed = found.interaction(lambda x, y, args: jnp.stack([0 * x[0], (1 - x[0] ** 2) * x[1]]))[0]
    periods = [lh.floquet(system, [2.0, 0.0], mu).period for mu in (1.0 - h, 1.0 + h)]
    assert_allclose(-found.period * pushed, (periods[1] - periods[0]) / (2 * h), rtol=1e-7)


def test_under_a_transformation_it_is_refused_with_what_to_do():
    with pytest.raises(ValueError, match="once for each set of values"):
        jax.jacfwd(lambda drive: lh.phase_response(LEAKY, [0.5], drive, phases=8).response)(1.7)


@pytest.mark.slow
def test_it_says_what_it_found():
    found = found_of("impact", phases=12)
    assert "Phase response" in str(found)
    data = found.to_xarray()
    assert data.response.dims == ("phase", "state")
    assert data.isostables.dims == ("phase", "state", "multiplier")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: lh.phase_response(zoo.impact_oscillator().system, [0.0, 1.0], zoo.impact_oscillator().args),
            "depend on",
        ),
        (lambda: lh.phase_response(lh.Map(lambda n, x, a: x), [0.0]), "takes an lh.Flow"),
        (lambda: lh.phase_response(CLOCK, [1.0, 0.2], phases=2), "at least 4"),
        (lambda: found_of("smooth", phases=8).finite([0.1]), "kick must have shape"),
        (
            lambda: lh.phase_response(PENDULUM, [np.pi / 2, 0.0]),
            "one of a family",
        ),
    ],
)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()
