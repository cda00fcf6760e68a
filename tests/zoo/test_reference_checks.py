"""`lyaphybrid validate`: problems against their references, by several ways; a wrong one is noticed."""

import dataclasses
import json
import math

import pytest

from lyaphybrid import zoo
from lyaphybrid.__main__ import main
from lyaphybrid.zoo import reference_checks
from lyaphybrid.zoo.problem import exact


@pytest.mark.slow
def test_two_ways_are_compared_and_written(tmp_path, capsys):
    out = tmp_path / "found.json"
    assert main(["validate", "--quick", "--out", str(out), "cat_map", "bouncing_ball"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("agrees") == 4
    assert "4 runs of 2 problems, 0 missed" in printed
    rows = json.loads(out.read_text())
    assert [row["way"] for row in rows[2:]] == ["dopri8, rtol = 1e-09", "dopri5, rtol = 1e-07"]
    assert rows[0]["known"] == list(zoo.cat_map().reference.exponents)


@pytest.mark.slow
def test_a_wrong_reference_is_noticed(monkeypatch, capsys):
    wrong = exact(0.9, -0.9, source="nobody")
    monkeypatch.setattr(
        reference_checks, "get", lambda name: lambda: dataclasses.replace(zoo.cat_map(), reference=wrong)
    )
    assert main(["validate", "--quick", "cat_map"]) == 1
    assert "MISSES" in capsys.readouterr().out


def test_an_unknown_problem_is_refused(capsys):
    assert main(["validate", "cat_mapp"]) == 2
    assert "cat_map" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["lorenz63", "henon_heiles", "rotated_dae", "stadium", "impact_oscillator"])
def test_there_are_four_ways(name):
    ways = reference_checks.ways_of(zoo.get(name)())
    assert len({way.name for way in ways}) == 4
    assert reference_checks.ways_of(zoo.get(name)(), quick=True) == [ways[0], ways[3]]


@pytest.mark.slow
def test_maps_and_flows_in_quick_mode(capsys):
    names = ["henon_map", "logistic_map", "standard_map", "baker_map", "lorenz63", "rossler", "henon_heiles"]
    assert main(["validate", "--quick", *names]) == 0, capsys.readouterr().out


@pytest.mark.slow
def test_a_run_that_has_lost_no_direction_yet_goes_on():
    """The pendulum sticks four times in ten thousand periods; its second way did not within the usual length."""
    found = list(reference_checks.comparisons(["friction_pendulum"], quick=True))
    assert [one.agrees for one in found] == [True, True]
    assert [one.exponents[-1] for one in found] == [-math.inf, -math.inf]
