"""Impacts slower and slower, beside the orbit that grazes: growth is right to two digits, or the result says so."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from grazing import METHODS, STATED, SYSTEM, grazing_case
from tests import near_grazing

FAST = {"default", "rk4 long"}
SPEEDS = [10.0**-k for k in np.arange(0, 9.5, 0.5)]


def answers(case, method):
    """The spectrum and the derivative of the end by the start."""
    how = {"t0": case.t0, "t1": case.t1, "method": method, "throw": False}
    spectrum = lh.lyapunov_spectrum(SYSTEM, case.x0, case.args, blocks=2, **how)
    return spectrum, lh.tangent_map(SYSTEM, case.x0, case.args, **how)


def judged(case, method) -> list[tuple[bool, float]]:
    """Of both results: whether they say that they graze; and the largest error, of the whole or as a part of it."""
    spectrum, tangent = answers(case, method)
    assert spectrum.status == tangent.status == lh.STATUS.ok
    growth = np.max(np.abs(np.asarray(spectrum.exponents) * case.t1 - np.sort(case.growth)[::-1]))
    matrix = np.linalg.norm(np.asarray(tangent.matrix) - case.matrix) / np.linalg.norm(case.matrix)
    states = [float(np.max(np.abs(np.asarray(found.x) - case.end))) for found in (spectrum, tangent)]
    said = ["grazing" in found.notes for found in (spectrum, tangent)]
    return list(zip(said, np.maximum([growth, matrix], states), strict=True))


def silently_wrong(case, method, allowed=STATED) -> list[float]:
    """The errors of results that are neither right nor noted as grazing."""
    return [float(error) for said, error in judged(case, method) if not said and not error < allowed]


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_right_or_said(name):
    silently = []
    for speed in SPEEDS[:: 3 if name in FAST else 1]:
        for restitution in (0.8,) if name in FAST else (1.0, 0.8, 0.3):
            case = grazing_case(speed, restitution)
            silently += [(speed, restitution, error) for error in silently_wrong(case, METHODS[name])]
    assert silently == []


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_decade_by_decade_the_growth_factor_is_right_or_the_result_says_so(name):
    """For impact speeds from 0.1 to 1e-6; and as often noted as in the kept table."""
    kept = [row for row in json.loads(near_grazing.TABLE.read_text()) if row["method"] == name]
    assert [row["decade"] for row in kept] == list(near_grazing.DECADES)
    for row in kept[:: 3 if name in FAST else 1]:
        found = near_grazing.found(name, row["decade"])
        assert found["without"] < STATED
        assert (found["noted"], found["cases"]) == (row["noted"], row["cases"])
        assert found["without"] < 3 * row["without"] + 1e-9  # rounding differs between machines


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dopri8", "dopri5"])
def test_a_step_that_ends_where_the_orbit_grazes(name):
    """There is nothing to cut it at: the guard has its extremum at the end of the first step of the second block."""
    method, silently = lh.RungeKutta(name, dt=0.25), []
    for speed in [1e-3, 1e-5, 3e-7, 1e-7, 3e-8] if name == "dopri5" else [3e-7]:
        for late in (0.0, 1e-12, -1e-9, 1e-6) if name == "dopri5" else (0.0,):
            silently += silently_wrong(grazing_case(speed, 0.8, before=2.0 + late), method)
    assert silently == []


@pytest.mark.slow
@pytest.mark.parametrize("by", ["clock", "guard"])
@pytest.mark.parametrize("method", [lh.RungeKutta("dopri5", dt=0.25), lh.RungeKutta("dopri5", rtol=1e-6, atol=1e-8)])
def test_another_event_at_the_instant_of_grazing(by, method):
    """The step ends at the tick of a clock, or at a root of another guard, exactly where the orbit grazes."""
    at = {
        "clock": lh.Transition(every=100.0, phase=lambda args: args["instant"]),
        "guard": lh.Transition(lambda t, x, args: args["instant"] - t),
    }[by]
    system, silently = lh.Hybrid(SYSTEM.fields[0], [*SYSTEM.transitions, at]), []
    for speed in (1e-4, 1e-6, 3e-7, 3e-8):
        case = grazing_case(speed, 0.8, before=1.9)
        args, how = case.args | {"instant": case.t0 + 1.9}, {"t0": case.t0, "t1": case.t1, "method": method}
        found = lh.lyapunov_spectrum(system, case.x0, args, **how)
        error = np.max(np.abs(np.asarray(found.exponents) * case.t1 - np.sort(case.growth)[::-1]))
        silently += [(speed, error)] if "grazing" not in found.notes and not error < STATED else []
    assert silently == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:x0 is float32")
@pytest.mark.parametrize("name", ["default", "rk4", "dopri5 steps"])
def test_right_or_said_in_float32(name):
    """Two digits are asked for there too, and a little more is allowed: the start itself is rounded."""
    silently = []
    for speed in SPEEDS:
        case = grazing_case(speed, 0.8, np.float32)
        silently += [(speed, error) for error in silently_wrong(case, METHODS[name], 3 * STATED)]
    assert silently == []


@pytest.mark.slow_cases("1.0")
@pytest.mark.parametrize("speed", [1.0, 0.1, 0.01, 3e-3])
def test_ordinary_impacts_are_not_called_grazing(speed):
    for said, error in judged(grazing_case(speed, 0.8), None):
        assert not said
        assert error < 1e-13 / speed**2 + 1e-11


def test_beside_the_grazing_orbit_errors_grow_as_theory_says():
    """An error δ of the guard changes the rate u of the impact by its acceleration times δ/u, a part of u like 1/u²."""
    for speed in (1e-3, 1e-4, 1e-5):
        for said, error in judged(grazing_case(speed, 0.8), None):
            assert said
            assert error < 1e-13 / speed**2


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, 0.03])
def test_derivatives_by_a_parameter(speed):
    """By the position of the wall; the closed form has 1/u."""
    case = grazing_case(speed, 0.8)

    def end(gap):
        how = {"t0": case.t0, "t1": case.t1, "throw": False}
        return lh.tangent_map(SYSTEM, jnp.asarray(case.x0), case.args | {"gap": gap}, **how).x

    ours = jax.jvp(end, (jnp.asarray(case.args["gap"]),), (jnp.asarray(1.0),))[1]
    assert np.allclose(ours, case.by_gap, rtol=1e-7, atol=0)


def test_the_exact_family_is_exact():
    """Its derivatives are those of its own end, by differences of 40 digits rounded to 16."""
    case, h = grazing_case(0.1, 0.8), 1e-6
    near = [grazing_case(0.1 + dh, 0.8) for dh in (-h, h)]
    moved, kicked = (near[1].x0 - near[0].x0), (near[1].end - near[0].end)
    assert np.allclose(case.matrix @ moved, kicked, rtol=0, atol=1e-4 * np.max(np.abs(kicked)))
