"""Orbits, their multipliers, branches and phase responses in other units of state and time: the same numbers."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import lyaphybrid as lh

UNITS = [
    ([1.0, 1.0, 1.0], 1.0),
    ([1e-12, 1e12, 1e3], 1.0),
    ([1e12, 1e-12, 1e-6], 1e6),
    ([1e-12, 1e-12, 1e-12], 1e-6),
    ([1e12, 1e12, 1e12], 1e6),
    ([1e6, 1.0, 1e-3], 1e-6),
    ([1.0, 1e-9, 1e9], 1e6),
]


def in_units(field, *jumps):
    """A system of x = y · unit and t = s · tick, in y and s; the jumps are (guard, reset) of x."""

    def scaled(t, y, args):
        unit = jnp.array(args["unit"])
        return args["tick"] * field(args["tick"] * t, y * unit, args["p"]) / unit

    transitions = [
        lh.Transition(
            lambda t, y, args, guard=guard: guard(y * jnp.array(args["unit"])) / args["unit"][0],
            lambda t, y, args, reset=reset: reset(y * jnp.array(args["unit"])) / jnp.array(args["unit"]),
        )
        for guard, reset in jumps
    ]
    return lh.Hybrid(scaled, transitions) if transitions else lh.Flow(scaled)


def args_of(unit, tick, p):
    return {"unit": tuple(unit), "tick": tick, "p": p}


# A cycle of radius 1, which drives x₂: multipliers 1, exp(−0.3 π), exp(−2 π).
CYCLE = in_units(
    lambda t, x, p: jnp.stack(
        [
            p * x[0] - 2 * x[1] - (x[0] ** 2 + x[1] ** 2) * x[0],
            2 * x[0] + p * x[1] - (x[0] ** 2 + x[1] ** 2) * x[1],
            -0.3 * x[2] + x[0] + 0.5 * x[2] * x[1],
        ]
    )
)
# A leaky integrator that tires: after each spike w is lower by 0.3.
NEURON = in_units(
    lambda t, x, p: jnp.stack([p - x[0] + x[1], -0.4 * x[1]]),
    (lambda x: 1 - x[0], lambda x: jnp.stack([0 * x[0], x[1] - 0.3])),
)
# A driven oscillator that hits a wall at 0.5 once in a period of 2π/0.9.
IMPACTS = in_units(
    lambda t, x, p: jnp.stack([x[1], p * jnp.cos(0.9 * t) - x[0] - 0.1 * x[1]]),
    (lambda x: 0.5 - x[0], lambda x: jnp.stack([x[0], -0.6 * x[1]])),
)


def spiking(p):
    """The adaptation after a spike and the period of the neuron's cycle, from its closed form; and the multiplier."""

    def interval(w):
        voltage = lambda t: p * (1 - np.exp(-t)) + w * (np.exp(-0.4 * t) - np.exp(-t)) / 0.6 - 1  # noqa: E731
        times = np.linspace(1e-6, 60, 200000)
        i = int(np.argmax(voltage(times) > 0))
        return brentq(voltage, times[i - 1], times[i], xtol=1e-15, rtol=1e-15)

    def after(w):
        return w * np.exp(-0.4 * interval(w)) - 0.3

    w = -0.3
    for _ in range(400):
        w = after(w)
    return interval(w), (after(w + 1e-5) - after(w - 1e-5)) / 2e-5


@pytest.mark.slow_cases("unit0-1.0")
@pytest.mark.parametrize(("unit", "tick"), UNITS)
def test_a_limit_cycle(unit, tick):
    found = lh.floquet(CYCLE, np.array([1.1, 0.2, 0.1]) / unit, args_of(unit, tick, 1.0), transient=3.0 / tick)
    assert_allclose(found.period * tick, np.pi, rtol=1e-12)
    assert_allclose(found.multipliers, [1.0, np.exp(-0.3 * np.pi), np.exp(-2 * np.pi)], rtol=1e-9)
    assert (found.stability, found.family, found.notes) == ("stable", 0, frozenset())


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "tick"), UNITS)
def test_a_spiking_neuron(unit, tick):
    unit = unit[:2]
    found = lh.floquet(NEURON, np.array([0.5, -0.1]) / unit, args_of(unit, tick, 1.8), transient=30.0 / tick)
    period, multiplier = spiking(1.8)
    assert_allclose(found.period * tick, period, rtol=1e-11)
    assert_allclose(found.multipliers, [1.0, multiplier], rtol=1e-8)
    same = lh.floquet(NEURON, [0.5, -0.1], args_of([1.0, 1.0], 1.0, 1.8), transient=30.0)
    assert_allclose(found.multipliers, same.multipliers, rtol=1e-9)
    assert (found.stability, found.family, found.notes, found.jumps) == ("stable", 0, frozenset(), 1)


@pytest.mark.slow_cases("unit0-1.0", "unit3-1e-06", "unit1-1.0", "unit2-1000000.0")
@pytest.mark.parametrize(("unit", "tick"), UNITS)
def test_a_driven_impact_oscillator(unit, tick):
    unit, turn = unit[:2], 2 * np.pi / 0.9
    found, same = (
        lh.floquet(
            IMPACTS, np.array([0.0, 0.3]) / one, args_of(one, of, 0.6), period=turn / of, transient=60 * turn / of
        )
        for one, of in ((unit, tick), ([1.0, 1.0], 1.0))
    )
    assert_allclose(found.multipliers, same.multipliers, rtol=1e-9)
    assert_allclose(np.asarray(found.x0) * unit, same.x0, rtol=1e-9)
    assert (found.stability, found.family, found.notes) == (same.stability, 0, frozenset())
    assert found.jumps == same.jumps > 0


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "tick"), UNITS[1:4])
def test_phase_responses_of_a_neuron(unit, tick):
    unit = unit[:2]
    found, same = (
        lh.phase_response(NEURON, np.array([0.5, -0.1]) / one, args_of(one, of, 1.8), transient=30.0 / of, phases=16)
        for one, of in ((unit, tick), ([1.0, 1.0], 1.0))
    )
    assert_allclose(found.multipliers, same.multipliers, rtol=1e-9)
    field = np.array([(1.8 - x[0] + x[1], -0.4 * x[1]) for x in found.x * unit])  # Z · f = 1
    assert_allclose(np.sum(found.response * tick / unit * field, axis=1), 1.0, rtol=1e-9)
    kick = np.array([0.0, 1e-5]) / unit
    assert_allclose(found.finite(kick, at=[2, 9]), found.response[[2, 9], 1] * kick[1], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "tick"), UNITS[1:4])
def test_a_branch_of_a_neuron(unit, tick):
    unit = unit[:2]
    branch = lh.continuation(
        NEURON, np.array([0.5, -0.1]) / unit, args_of(unit, tick, 1.8), over={"p": (1.5, 2.5)}, transient=30.0 / tick
    )
    assert branch.ends == ("range", "range")
    for p, orbit in zip(branch.values[::8], branch.orbits[::8], strict=True):
        period, multiplier = spiking(p)
        assert_allclose(orbit.period * tick, period, rtol=1e-11)
        assert_allclose(orbit.multipliers, [1.0, multiplier], rtol=1e-8)
        assert (orbit.stability, orbit.family) == ("stable", 0)
