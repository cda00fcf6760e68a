"""The comparison of symplectic schemes: what it counts, and whom it calls the winner."""

import numpy as np
import pytest

import lyaphybrid as lh
from benchmarks import work_precision as wp


def test_kicks_are_evaluations_of_the_force():
    """A kick at the end of a step is that at the start of the next."""
    names = {"leapfrog": 1, "ForestRuth": 3, "SABA2C": 2, "SBAB2C": 2, "ABA864": 7, "SRKN11b": 11, "SRKN14a": 14}
    assert {name: wp.kicks(name) for name in names} == names


def test_steps_divide_the_lengths():
    for scheme in wp.COMPARED:
        for dt in wp.steps(scheme):
            for length in (wp.TANGENT, wp.LENGTH / wp.LOOKS):
                assert abs(length / dt - round(length / dt)) < 1e-9


def points(*pairs):
    return [wp.Point(0.1, seconds, error, error) for seconds, error in pairs]


def test_the_cost_of_an_error_lies_between_two_points():
    found = points((1.0, 1e-4), (10.0, 1e-8))
    assert wp.cost_of(found, 1e-6) == pytest.approx(np.sqrt(10.0))
    assert wp.cost_of(found, 1e-9) == np.inf
    assert wp.cost_of(found, 1e-3) == 1.0


def test_the_score_is_a_mean_of_ratios():
    cheap = points(*((10.0**i, 10.0 ** (-3 - 2 * i)) for i in range(5)))
    dear = [point._replace(seconds=3 * point.seconds) for point in cheap]
    found = wp.ratios({"a": {"dear": dear, "cheap": cheap}, "b": {"dear": dear, "cheap": cheap}})
    assert list(found) == ["cheap", "dear"]
    assert found["cheap"] == pytest.approx([1.0] * len(wp.TARGETS))
    assert found["dear"] == pytest.approx([3.0] * len(wp.TARGETS))


@pytest.mark.slow
def test_errors_fall_with_the_order():
    name = "Hénon–Heiles"
    problem = wp.PROBLEMS[name]()
    for scheme, order in (("leapfrog", 2), ("SRKN14a", 6)):
        both = []
        for dt in (0.5, 0.25) if order == 6 else (0.1, 0.05):
            method = lh.Symplectic(scheme, dt=dt)
            both.append((wp.energy_error(problem, method), wp.tangent_error(name, problem, method)))
        ratios = np.log2(np.array(both[0]) / np.array(both[1]))
        print(scheme, both, ratios)
        assert np.all(np.abs(ratios - order) < 0.3 * order)


def test_the_figure_shows_every_scheme():
    found = {"a": {scheme: points((1e-7, 1e-4), (1e-6, 1e-9)) for scheme in ("leapfrog", "SABA2C")}}
    axes = wp.figure(found).axes
    assert len(axes) == 2
    assert [line.get_label() for line in axes[0].get_lines()] == ["leapfrog", "SABA2C"]
