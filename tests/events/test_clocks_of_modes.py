"""Equal clocks of several modes: that of the mode which is entered waits for the next tick."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

RATES = {"on": -2.0, "off": 0.5, "rest": 0.25}
FIELDS = {name: lambda t, x, args, rate=rate: rate * x for name, rate in RATES.items()}


def ring(*modes, reverse=False):
    """One mode after another, each for a unit of time."""
    clocks = [
        lh.Transition(every=1.0, source=source, target=target)
        for source, target in zip(modes, modes[1:] + modes[:1], strict=True)
    ]
    return lh.Hybrid({name: FIELDS[name] for name in modes}, clocks[::-1] if reverse else clocks)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("modes", [("on", "off"), ("on", "off", "rest")])
def test_modes_take_turns(modes, reverse):
    system, count = ring(*modes, reverse=reverse), len(modes)
    found = lh.trajectory(system, [1.0], t1=6.0, times=np.arange(6) + 1.0, mode="on")
    assert found.events.t.tolist() == [1, 2, 3, 4, 5, 6]
    rates = [RATES[modes[i % count]] for i in range(6)]
    assert_allclose(found.x[:, 0], np.exp(np.cumsum(rates)), rtol=1e-8)
    spectrum = lh.lyapunov_spectrum(system, [1.0], t1=60.0, transient=0.0, mode="on")
    assert_allclose(spectrum.exponents, np.mean([RATES[mode] for mode in modes]), rtol=1e-9)


def test_a_clock_that_was_armed_before_ticks_in_its_turn():
    """Of three clocks at one time the first changes the mode, the second is of both modes, the third of the new one."""

    def put(digit):
        return lambda t, x, args: 10 * x + digit

    system = lh.Hybrid(
        {"on": lambda t, x, args: 0 * x, "off": lambda t, x, args: 0 * x},
        [
            lh.Transition(reset=put(1.0), every=1.0, source="on", target="off"),
            lh.Transition(reset=put(2.0), every=1.0),
            lh.Transition(reset=put(3.0), every=1.0, source="off", target="on"),
        ],
    )
    found = lh.trajectory(system, [0.0], t1=2.5, times=[0.5, 1.5, 2.5], mode="on")
    assert found.x[:, 0].tolist() == [0, 12, 1223]
    assert found.mode.tolist() == [0, 1, 0]
