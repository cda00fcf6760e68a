"""Events that users of other projects saw missed, doubled, in the wrong order, too late or too dear.

Each test names the public thread that it comes from, and holds what is right in closed form. README.md lists them all.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import STATUS

# --- a path that is a polynomial of time, and guards of path and time ------------------------------------------------


def _guards(t, x, args):
    y = x[0]
    return args["guards"] @ jnp.stack([jnp.ones_like(y), y, y**2, y**3, t, jnp.cos(t)])


PATH = lh.Hybrid(
    lambda t, x, args: jnp.stack([args["rate"] @ jnp.stack([jnp.ones_like(t), t, t**2])]),
    lh.Transition(_guards, direction=0),
)
ADAPTIVE, FIXED = lh.RungeKutta(), lh.RungeKutta("rk4", dt=0.25)
ROW = {"1": 0, "y": 1, "y²": 2, "y³": 3, "t": 4, "cos t": 5}


def events(rate, guards, start=0.0, *, t0=0.0, t1, method=ADAPTIVE):
    """The log of a run; `guards`: two dictionaries of coefficients, or one."""
    rows = np.zeros((2, 6))
    rows[1, 0] = 1.0
    for row, guard in zip(rows, guards, strict=False):
        row[:] = 0.0
        for term, factor in guard.items():
            row[ROW[term]] = factor
    args = {"rate": np.array(rate, float), "guards": rows}
    run = lh.trajectory(PATH, [start], args, t0=t0, t1=t1, n=1, method=method)
    assert run.status == STATUS.ok
    return run.events


@pytest.mark.parametrize("method", [ADAPTIVE, FIXED], ids=["adaptive", "fixed"])
def test_three_roots_of_a_cubic_path(method):
    """https://github.com/scipy/scipy/issues/9228: of -6, -2 and 2 only the first was found.

    y' = 3 t² + 12 t - 4 from y(-8) = -120 to t = 4. The error estimate of such a path is zero.
    """
    log = events([-4, 12, 3], [{"y": 1.0}], -120.0, t0=-8.0, t1=12.0, method=method)
    assert_allclose(log.t, [-6, -2, 2], rtol=0, atol=1e-11)


def test_a_cubic_guard_on_a_straight_path():
    """https://github.com/patrick-kidger/diffrax/issues/507: two changes of sign within a large step cancel.

    (2.5 - y) (5 - y) (0 - y) along y' = 1 from -1.
    """
    log = events([1, 0, 0], [{"y": -12.5, "y²": 7.5, "y³": -1.0}], -1.0, t1=12.0)
    assert_allclose(log.t, [1.0, 3.5, 6.0], rtol=0, atol=1e-11)


def test_two_roots_of_a_cosine():
    """https://github.com/SciML/DifferentialEquations.jl/issues/1087: cos t + 0.9 twice within a step, forwards."""
    first = np.arccos(-0.9)
    for t0 in (0.0, 2.0, 2.6):
        log = events([1, 0, 0], [{"cos t": 1.0, "1": 0.9}], t0=t0, t1=5.0 - t0)
        assert_allclose(log.t, [first, 2 * np.pi - first], rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [0, 1])
def test_the_first_of_two_in_one_step(order):
    """https://github.com/patrick-kidger/diffrax/issues/639: the later in the list was taken for the first."""
    guards = [{"t": 1.0, "1": -1.0}, {"t": 1.0, "1": -0.5}]
    log = events([1, 0, 0], guards[::-1] if order else guards, t1=10.0)
    assert_allclose(log.t, [0.5, 1.0], rtol=0, atol=1e-13)
    assert np.asarray(log.which).tolist() == ([0, 1] if order else [1, 0])


def test_events_exactly_on_steps():
    """https://github.com/SciML/DifferentialEquations.jl/issues/258: u = 0.001 was found, u = 0.002 was not."""
    guards = [{"y": 1.0, "1": -0.001}, {"y": 1.0, "1": -0.002}]
    for dt in (1e-3, 2e-3, 1e-4, 3e-4):
        log = events([1, 0, 0], guards, t1=0.01, method=lh.RungeKutta("rk4", dt=dt))
        assert_allclose(log.t, [0.001, 0.002], rtol=1e-12, atol=0)


def test_the_same_condition_twice():
    """https://github.com/SciML/DiffEqBase.jl/issues/837 and 889: a loop without end, or one of the two."""
    log = events([1, 0, 0], [{"y": 1.0, "1": -2.95}] * 2, t1=10.0)
    assert_allclose(log.t, [2.95, 2.95], rtol=1e-13)
    assert np.asarray(log.which).tolist() == [0, 1]


@pytest.mark.parametrize("direction", [-1, 0])
def test_three_oscillators_that_cross_at_once_are_counted_once_each(direction):
    """The first of those threads with resets: each adds one to its own number and leaves its guard at zero."""
    counted = lh.Hybrid(
        lambda t, x, args: jnp.concatenate([jnp.ones_like(x[:3]), jnp.zeros_like(x[3:])]),
        lh.Transition(
            lambda t, x, args: 1.5 - x[:3], lambda t, x, args, which: x.at[3 + which].add(1.0), direction=direction
        ),
    )
    run = lh.trajectory(counted, np.zeros(6), t1=4.0, n=1)
    assert_allclose(run.x[-1], [4, 4, 4, 1, 1, 1], rtol=1e-14)


@pytest.mark.parametrize("acceleration", [1e12, 1e16, 1.602176634e-19 / 9.1093837015e-31 * 1e9])
def test_an_event_on_a_very_small_scale_of_time(acceleration):
    """https://github.com/scipy/scipy/issues/15262: roots to four units of rounding of 1, in a run of 1e-13.

    From rest through a micrometre: √(2 d / a). The last is that thread's electron in 1e9 V/m.
    """
    distance = 1e-6
    instant = np.sqrt(2 * distance / acceleration)
    log = events([0, acceleration, 0], [{"y": 1.0, "1": -distance}], t1=1.51 * instant)
    assert_allclose(log.t, [instant], rtol=1e-12)


# --- resets ----------------------------------------------------------------------------------------------------------


def test_a_neuron_that_is_reset_and_goes_on():
    """https://github.com/patrick-kidger/diffrax/issues/277 and 492: a state that an event changes, until the end.

    τ V' = E - V + R I with a threshold: spikes at multiples of τ ln((R I) / (R I + E - threshold)).
    """
    tau, rest, drive, threshold = 10.0, -65.0, 30.0, -50.0
    neuron = lh.Hybrid(
        lambda t, x, args: (rest - x + args) / tau,
        lh.Transition(lambda t, x, args: threshold - x[0], lambda t, x, args: jnp.full_like(x, rest)),
    )
    run = lh.trajectory(neuron, [rest], drive, t1=1000.0, n=1, method=lh.RungeKutta(rtol=1e-11))
    interval = tau * np.log(drive / (drive + rest - threshold))
    assert len(run.events) == int(1000 / interval)
    assert_allclose(run.events.t, interval * np.arange(1, len(run.events) + 1), rtol=1e-9)


@pytest.mark.slow
def test_a_ball_never_falls_through_the_floor():
    """https://github.com/SciML/DifferentialEquations.jl/issues/696: with restitution 0.5, and with none.

    From 1 above the floor at speed 1 upwards, g = 9.8: bounces accumulate, and the run says so instead of going on.
    """
    ball = lh.Hybrid(
        {"fly": lambda t, x, args: jnp.stack([x[1], jnp.full_like(x[1], -9.8)]), "rest": lambda t, x, args: 0 * x},
        [
            lh.Transition(
                lambda t, x, args: x[0] + 1,
                lambda t, x, args: jnp.stack([x[0], -args * x[1]]),
                source="fly",
                when=lambda t, x, args: args > 0,
            ),
            lh.Transition(
                lambda t, x, args: x[0] + 1,
                lambda t, x, args: jnp.stack([x[0], 0 * x[1]]),
                source="fly",
                target="rest",
                when=lambda t, x, args: args == 0,
            ),
        ],
    )
    landed = (1 + np.sqrt(1 + 2 * 9.8)) / 9.8
    speed = 9.8 * landed - 1
    bouncing = lh.trajectory(ball, [0.0, 1.0], 0.5, t1=2.0, n=200, mode="fly", throw=False)
    assert bouncing.status == STATUS.zeno
    assert np.nanmin(bouncing.x[:, 0]) > -1 - 1e-12
    ends = landed + 2 * speed / 9.8  # Σ 2 v eᵏ/g for e = 1/2
    assert_allclose(bouncing.events.t[-1], ends, rtol=1e-6)
    resting = lh.trajectory(ball, [0.0, 1.0], 0.0, t1=2.0, n=1, mode="fly")
    assert_allclose(resting.x[-1], [-1.0, 0.0], rtol=0, atol=1e-13)
    assert_allclose(resting.events.t, [landed], rtol=1e-13)


@pytest.mark.slow
def test_a_sample_and_a_sawtooth_at_the_same_times():
    """https://github.com/OpenModelica/OpenModelica/issues/12246: time events and state events that coincide.

    Each period T the duty d is sampled and the sawtooth starts again; the switch opens where the sawtooth reaches d.
    """
    period, periods = 1e-3, 1000

    def duty(t):
        return 0.5 + 0.3 * jnp.sin(40.0 * t)

    def restarted(t, x, args):
        return jnp.stack([0 * x[0], duty(t), x[2]])

    def rising(slope):
        return lambda t, x, args: jnp.stack([1 / args, 0 * x[1], slope + 0 * x[2]])

    chopper = lh.Hybrid(
        {"closed": rising(1.0), "open": rising(0.0)},
        [
            lh.Transition(every=lambda args: args, reset=restarted, target="closed"),
            lh.Transition(lambda t, x, args: x[1] - x[0], source="closed", target="open"),
        ],
    )
    end = periods * period
    run = lh.trajectory(chopper, [0.0, 0.5, 0.0], period, t1=end - period / 2, n=1, mode="closed")
    starts = period * np.arange(periods)
    duties = np.asarray(duty(starts))
    assert len(run.events) == 2 * periods - 1 - (duties[-1] > 0.5)
    opened = np.asarray(run.events.t)[np.asarray(run.events.transition) == 1]
    assert_allclose(opened, (starts + duties * period)[: len(opened)], rtol=0, atol=1e-12)
    assert_allclose(run.x[-1, 2], period * np.sum(np.append(duties[:-1], min(duties[-1], 0.5))), rtol=1e-10)


# --- many guards ------------------------------------------------------------------------------------------------------


def _equations(jaxpr) -> int:
    inner = [value for eqn in jaxpr.eqns for value in jax.tree.leaves(tuple(eqn.params.values()))]
    return len(jaxpr.eqns) + sum(_equations(getattr(one, "jaxpr", one)) for one in inner if hasattr(one, "eqns"))


@pytest.mark.slow
def test_two_hundred_guards():
    """https://github.com/patrick-kidger/diffrax/issues/637: 200 guards cost 119 times as much as one.

    y' = -y of 200 components, each with a guard y - 0.1: all found, in order; the program is as long as for one guard.
    """
    starts = np.random.default_rng(0).uniform(0.9, 1.0, 200)

    def decay(guard):
        return lh.Hybrid(lambda t, x, args: -x, lh.Transition(guard, direction=0))

    many, one = decay(lambda t, x, args: x - 0.1), decay(lambda t, x, args: x[:1] - 0.1)
    log = lh.trajectory(many, starts, t1=5.0, n=1, method=lh.RungeKutta(rtol=1e-11, atol=1e-13)).events
    assert_allclose(log.t, np.sort(np.log(10 * starts)), rtol=0, atol=1e-10)
    assert np.asarray(log.which).tolist() == np.argsort(starts).tolist()

    def length(system):
        return _equations(
            jax.make_jaxpr(lambda x0: lh.trajectory(system, x0, t1=5.0, n=1, throw=False).x)(starts).jaxpr
        )

    assert length(many) < 1.02 * length(one)


# --- indicators ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_events_keep_the_energy_in_every_indicator():
    """https://github.com/JuliaDynamics/ChaosTools.jl/issues/324: each event changed the energy in runs for indicators.

    A centre at distance r from an ellipse that turns; its momentum is turned round where they touch; H = p²/2 + r.
    """

    def gap(t, x, args):
        return x[0] - jnp.sqrt(jnp.cos(x[2]) ** 2 + (0.8 * jnp.sin(x[2])) ** 2) - 1.0

    contact = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -jnp.ones_like(x[1]), 0.1 + 0 * x[2]]),
        lh.Transition(gap, lambda t, x, args: x.at[1].multiply(-1.0)),
    )
    start = np.array([4.0, 0.3, 0.0])

    def energy(x):
        return x[..., 1] ** 2 / 2 + x[..., 0]

    spectrum = lh.lyapunov_spectrum(contact, start, t1=500.0)
    assert spectrum.jumps > 90
    assert_allclose(energy(np.asarray(spectrum.x)), energy(start), rtol=1e-8)
    vectors = lh.covariant_vectors(contact, start, t1=500.0)
    assert_allclose(vectors.exponents, spectrum.exponents, rtol=0, atol=0.02)
