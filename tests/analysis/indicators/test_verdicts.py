"""Verdicts of indicators from courses of known laws: powers of the time, exponentials, losses, too few times."""

import numpy as np
import pytest

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
