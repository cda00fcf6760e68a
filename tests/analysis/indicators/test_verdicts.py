"""Verdicts of indicators from courses of known laws: powers of the time, exponentials, losses, too few times."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.analysis.indicators.verdicts import of_alignment, of_fli, of_megno

TIME = np.geomspace(1.0, 1000.0, 40)
JUDGES = [of_alignment, of_megno, of_fli]


@pytest.mark.parametrize("judge", JUDGES)
@pytest.mark.parametrize("count", [0, 7])
def test_few_times_are_no_verdict(judge, count):
    assert judge(TIME[:count], TIME[:count]) == ("undecided", "fewer than 8 times")


@pytest.mark.parametrize("judge", JUDGES)
def test_times_that_were_not_reached_do_not_count(judge):
    time = np.where(np.arange(40) < 7, TIME, np.nan)
    assert judge(time, np.zeros(40)).kind == "undecided"


@pytest.mark.parametrize(
    ("logs", "kind", "reason"),
    [
        (-2 * np.log(TIME), "regular", "like t^-2.00"),
        (-0.5 * TIME, "chaotic", "like exp(-0.5 t)"),
        (-5 * np.log(TIME), "undecided", "like t^-5.0: follow the orbit for longer"),
        (np.where(TIME > 500, -np.inf, -TIME), "undecided", "a jump destroyed a direction"),
    ],
)
def test_alignment(logs, kind, reason):
    found = of_alignment(TIME, logs)
    assert found.kind == kind
    assert reason.replace("\\", "") in found.reason
    assert str(found) == f"{kind}: {found.reason}"


@pytest.mark.parametrize(
    ("means", "kind", "reason"),
    [
        (2 - 1 / TIME, "regular", "its mean stands at 2.00"),
        (2.2 + 0 * TIME, "regular", "its mean stands at 2.20"),
        (0.05 * TIME, "chaotic", "its mean grows like 0.05 t"),
        (3 + 0 * TIME, "undecided", "its mean stands at 3.00: follow the orbit for longer"),
        (np.where(TIME > 500, -np.inf, 2.0), "undecided", "a jump destroyed the deviation vector"),
    ],
)
def test_megno(means, kind, reason):
    assert of_megno(TIME, means) == (kind, reason)


@pytest.mark.parametrize(
    ("values", "kind", "reason"),
    [
        (np.log(TIME), "regular", "it grows like 1.00 ln t"),
        (0.1 * TIME, "chaotic", "it grows like 0.1 t"),
        (5 * np.log(TIME), "undecided", "it grows like 5.0 ln t: follow the orbit for longer"),
    ],
)
def test_fli(values, kind, reason):
    assert of_fli(TIME, values) == (kind, reason)


ATTRACTORS = {
    "van der Pol's cycle": (lh.Flow(lambda t, x, a: jnp.stack([x[1], (1 - x[0] ** 2) * x[1] - x[0]])), [2.0, 0.0], 300),
    "a node": (lh.Flow(lambda t, x, a: x * jnp.array([-1.0, -3.0])), [2.0, 1.0], 100),
    "a node of a map": (lh.Map(lambda n, x, a: x * jnp.array([0.5, 0.7])), [0.1, 0.2], 1000),
}


@pytest.mark.parametrize("indicator", [lh.gali, lh.sali])
@pytest.mark.parametrize("name", ATTRACTORS)
def test_an_attractor_aligns_deviation_vectors_without_chaos(name, indicator):
    system, x0, t1 = ATTRACTORS[name]
    found = indicator(system, x0, t1=t1)
    assert found.verdict.kind == "undecided"
    assert "no deviation vector grows" in found.verdict.reason


def test_growth_of_a_deviation_vector():
    """The cat map: ln of the length grows by ln((3 + √5)/2) an iteration, from whatever direction, up to a constant."""
    cat = lh.Map(lambda t, x, args: jnp.stack([2 * x[0] + x[1], x[0] + x[1]]) % 1.0)
    found = lh.gali(cat, [0.1, 0.2], t1=100, times=np.array([50.0, 100.0]))
    assert found.log_growth[1] - found.log_growth[0] == pytest.approx(50 * np.log((3 + np.sqrt(5)) / 2), rel=1e-9)
