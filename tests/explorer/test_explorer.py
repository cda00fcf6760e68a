"""The explorer: what it computes is what the verbs compute, moves compile nothing, failures are words."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_array_equal

import lyaphybrid as lh
from lyaphybrid._jax.engines import compilations
from lyaphybrid.explorer.figures import figure_of

LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))


class Counted:
    """A function that counts how often it is traced."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, *given):
        self.calls += 1
        return self.function(*given)


def spiral(t, x, args):
    return jnp.stack([x[1], -args["k"] * x[0] - args["c"] * x[1]])


def turned(t, x, args):
    return jnp.stack([x[0], -args["e"] * x[1]])


def forced(t, x, args):
    return jnp.stack([x[1], jnp.cos(t) - args["k"] * x[0] - args["c"] * x[1]])


def flow():
    field = Counted(spiral)
    return lh.Flow(field, names=("angle", "rate"), units=("rad", "rad/s")), field, [1.0, 0.0], {"k": 1.0, "c": 1e-4}


def hybrid():
    field = Counted(forced)
    wall = lh.Transition(lambda t, x, args: x[0] + 0.1, turned)
    return lh.Hybrid(field, wall, names=("x", "v")), field, [1.0, 0.0], {"k": 1.0, "c": 0.1, "e": 0.8}


def mapped():
    rule = Counted(lambda n, x, args: jnp.stack([1 - args["a"] * x[0] ** 2 + x[1], args["b"] * x[0]]))
    return lh.Map(rule), rule, [0.1, 0.1], {"a": 1.4, "b": 0.3}


def hamiltonian():
    potential = Counted(lambda q, args: args["k"] * jnp.sum(q**2) / 2 + q[0] ** 2 * q[1])
    return lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, potential), potential, [0.0, 0.1, 0.3, 0.0], {"k": 1.0}


def dae():
    residual = Counted(lambda t, x, args: jnp.stack([x[2], -args["k"] * x[0], x[2] - x[1]]))
    leading = jnp.diag(jnp.array([1.0, 1.0, 0.0]))
    return lh.DAE(lambda t, args: leading, residual, 2), residual, [1.0, 0.0, 5.0], {"k": 1.0}


SYSTEMS = {"flow": flow, "hybrid": hybrid, "map": mapped, "hamiltonian": hamiltonian, "dae": dae}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SYSTEMS)
def test_moves_trace_and_compile_nothing_and_give_what_the_verbs_give(kind):
    system, function, x0, args = SYSTEMS[kind]()
    explorer = lh.explore(system, x0, args, t1=200)
    name = next(iter(args))
    assert compilations() > 0
    before, traced = compilations(), function.calls
    assert traced > 0
    for factor in (0.97, 0.95):
        view = explorer.move({name: factor * args[name], "x0[0]": x0[0] + 0.01})
    assert compilations() == before
    assert function.calls == traced or kind == "dae"  # consistent_start checks the functions of a DAE at each start
    own, start = args | {name: 0.95 * args[name]}, [x0[0] + 0.01, *x0[1:]]
    start = lh.consistent_start(system, start, own) if kind == "dae" else start
    alone = lh.lyapunov_spectrum(system, start, own, t1=200, transient=20)
    assert_array_equal(view.spectrum.exponents, alone.exponents)
    assert_array_equal(view.trajectory.x[-1], lh.trajectory(system, start, own, t1=10, n=len(view.trajectory.x)).x[-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["lorenz63", "impact_oscillator", "bouncing_ball", "sinai_billiard", "friction_pendulum"]
)
def test_problems_of_the_zoo(name):
    problem = lh.zoo.get(name)()
    explorer = lh.explore(problem)
    before = compilations()
    knob = explorer.knobs[0]
    view = explorer.move({knob.name: 0.999 * knob.value})
    assert compilations() == before
    assert view.words == ()
    assert view.spectrum.status == lh.STATUS.ok
    assert np.all(np.isfinite(view.section.t))
    assert isinstance(explorer.figure(), Figure)
    assert isinstance(explorer.figure(phase=False), Figure)
    first = explorer.reset().spectrum.exponents
    assert_array_equal(first, lh.explore(problem).view.spectrum.exponents)


@pytest.mark.slow
def test_the_section_suits_the_kind_of_system():
    ball, _, x0, args = hybrid()
    hits = lh.explore(ball, x0, args, t1=100.0).view
    run = lh.trajectory(ball, x0, args, t1=100.0, n=2)
    late = np.asarray(run.events.t) > 50.0
    assert_array_equal(hits.section.t, run.events.t[late])
    assert_array_equal(hits.section.x, run.events.x_after[late])
    strobe = lh.explore(ball, x0, args, t1=100.0, period=2 * np.pi).view.section
    np.testing.assert_allclose(np.diff(strobe.t), 2 * np.pi, rtol=1e-12)
    swing, _, x0, args = flow()
    crossings = lh.explore(swing, x0, args, t1=100.0).view.section
    np.testing.assert_allclose(crossings.x[:, 0], 0.0, atol=1e-12)
    assert np.all(crossings.x[:, 1] < 0)  # it falls
    own = lh.explore(swing, x0, args, t1=100.0, section=lambda t, x, args: x[1]).view.section
    np.testing.assert_allclose(own.x[:, 1], 0.0, atol=1e-12)


@pytest.mark.slow
def test_what_fails_is_said_in_words_and_can_be_undone():
    explorer = lh.explore(lh.zoo.logistic_map())
    before = explorer.view.spectrum.exponents
    view = explorer.move({"r": 4.2})
    (said,) = view.words
    assert said.startswith("trajectory, section, spectrum: nonfinite: the state became infinite")
    assert "status" not in str(view.table().notes)  # it stands among the words
    assert isinstance(figure_of(view), Figure)
    assert "nonfinite" in repr(explorer)
    assert_array_equal(explorer.reset().spectrum.exponents, before)
    assert explorer.view.words == ()


@pytest.mark.slow
def test_arguments_that_a_move_makes_wrong_are_words():
    ticks = lh.Hybrid(lambda t, x, args: -x, lh.Transition(every=lambda args: args["every"]))
    explorer = lh.explore(ticks, [1.0], {"every": 1.0}, t1=20.0)
    view = explorer.move({"every": -1.0})
    assert view.trajectory is view.section is view.spectrum is None
    assert "every of transition 0 must be positive" in view.words[0]
    assert isinstance(figure_of(view), Figure)


@pytest.mark.slow
def test_knobs_have_names_units_and_ranges():
    system, _, x0, args = flow()
    explorer = lh.explore(system, x0, args, t1=50.0)
    by_name = {knob.name: knob for knob in explorer.knobs}
    assert list(by_name) == ["c", "k", "x0[0]", "x0[1]"]
    assert by_name["x0[1]"].label == "start rate (rad/s)"
    assert all(knob.low <= knob.value <= knob.high and knob.low < knob.high for knob in explorer.knobs)
    assert by_name["c"].logarithmic
    assert (by_name["k"].low, by_name["k"].high, by_name["k"].logarithmic) == (0.0, 2.0, False)
    farthest = np.max(np.abs(np.asarray(explorer.view.trajectory.x)[:, 1]))
    assert by_name["x0[1]"].high == pytest.approx(farthest)


@pytest.mark.slow
def test_whole_numbers_can_be_varied():
    explorer = lh.explore(LOGISTIC, [0.3], 3, t1=100)
    assert explorer.move({"args": 3.2}).words == ()
    assert explorer.args == 3.2


@pytest.mark.slow
def test_entries_by_name():
    pair = lh.Map(lambda n, x, args: args["rates"]["both"] * x * (1 - x))
    explorer = lh.explore(
        pair, [0.3, 0.4], {"rates": {"both": jnp.array([3.5, 3.6])}}, t1=100, over={"rates.both[1]": (3.0, 4.0)}
    )
    explorer.move({"rates.both[1]": 3.7})
    assert_array_equal(explorer.args["rates"]["both"], [3.5, 3.7])
    assert [(knob.low, knob.high) for knob in explorer.knobs] == [(3.0, 4.0)]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"x0": None, "t1": 10}, "explore needs a start x0"),
        ({"x0": [0.3]}, "explore needs t1"),
        ({"x0": [[0.3], [0.4]], "t1": 10}, "x0 must be one start"),
        ({"x0": [0.3], "t1": 10, "over": ["q"]}, "none of what can be varied: args, x0"),
        ({"x0": [0.3], "t1": 10, "over": {"args": (4.0, 3.0)}}, "The range of args in over"),
        ({"x0": [0.3], "t1": 10, "over": 3}, "over must be names"),
        ({"x0": [0.3], "t1": 10, "section": 0}, "which has no transitions"),
        ({"x0": [0.3], "t1": 10, "section": 0, "period": 1}, "Give section or period, not both"),
        ({"x0": [0.3], "t1": 10, "components": (0, 5)}, "components must be the index"),
        ({"x0": [0.3], "t1": 10, "components": 1}, "components must be two indices"),
        ({"x0": [0.3], "t1": 10.5}, "whole number"),
    ],
)
def test_bad_arguments(given, message):
    start = given.pop("x0")
    with pytest.raises(ValueError, match=message):
        lh.explore(LOGISTIC, start, 3.7, **given)


def test_a_move_of_what_is_not_there():
    explorer = lh.explore(LOGISTIC, [0.3], 3.7, t1=100)
    with pytest.raises(ValueError, match="There is no 'q' to move; there is args, x0"):
        explorer.move({"q": 1.0})
    with pytest.raises(ValueError, match="args must be"):
        explorer.move({"args": "high"})


def test_without_ipywidgets_an_error_names_the_extra(monkeypatch):
    explorer = lh.explore(LOGISTIC, [0.3], 3.7, t1=100)
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(ImportError, match=r"pip install 'lyaphybrid\[notebooks\]'"):
        explorer.widget()


@pytest.mark.slow
def test_sliders_move_the_explorer():
    pytest.importorskip("ipywidgets", reason="ipywidgets, extra notebooks")
    explorer = lh.explore(LOGISTIC, [0.3], 3.7, t1=400)
    left, right = explorer.widget().children
    (sliders, back), (kind, picture, words) = left.children, right.children
    first = bytes(picture.value)
    assert first.startswith(b"\x89PNG")
    assert [slider.description for slider in sliders.children] == ["args", "start x0"]
    sliders.children[0].value = 3.2
    assert explorer.args == 3.2
    assert bytes(picture.value) != first
    assert "λ1" in words.value
    sliders.children[0].value = 4.2 if sliders.children[0].max >= 4.2 else sliders.children[0].max
    assert "nonfinite" in words.value
    back.click()
    assert explorer.values == {"args": 3.7, "x0[0]": 0.3}
    assert bytes(picture.value) == first
    kind.value = "in time"
    assert isinstance(explorer.figure(phase=False), Figure)
