"""The tables of a hybrid system against what its transitions say, entry by entry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import lyaphybrid as lh
from lyaphybrid.events.compiled_hybrid import by_mode, projection, wire
from lyaphybrid.systems.bound import Bound
from lyaphybrid.systems.daes.eliminations import Eliminated

T, X, ARGS = jnp.asarray(0.5), jnp.asarray([2.0, 3.0, 4.0]), 10.0
WHICH, MODE = jnp.asarray(1, jnp.int32), jnp.asarray(0, jnp.int32)


def _moving(t, x, a):
    return jnp.stack([x[1], a + 0 * t, 0 * x[0]])


def _pairs(t, x, a):
    return jnp.stack([x[0] - a, x[1] - t])


SYSTEM = lh.Hybrid(
    {"up": _moving, "down": lambda t, x, a: -x, "side": lambda t, x, a: 2 * x},
    [
        lh.Transition(lambda t, x, a: x[0] + a * t, lambda t, x, a: x + a, source="up", target="down", direction=1),
        lh.Transition(every=1.0, reset=lambda t, x, a: 3 * x, source=("up", "side")),
        lh.Transition(
            _pairs,
            lambda t, x, a, which: x.at[which].set(a),
            source=("up", "down"),
            target=lambda t, x, a, which: which + 1,
            direction=0,
            when=lambda t, x, a: x[0] > a,
        ),
        lh.Transition(lambda t, x, a: x[2] - a, source="down", target=lambda t, x, a: x[0]),
        lh.Transition(lambda t, x, a: x[2], source="side"),
        lh.Transition(_pairs, source="side", when=lambda t, x, a: jnp.stack([x[0] < a, x[0] > a])),
    ],
    tangent={"down": lambda t, x, a, dx: a * dx},
    flow_set={"down": lambda t, x, a: a - x[2]},
    initial_mode=lambda t, x, a: jnp.asarray(x[0] < a, jnp.int32),
)


@pytest.fixture(scope="module")
def tables():
    return wire(SYSTEM, T, X, ARGS)


def test_each_mode_has_its_guards_in_the_order_of_the_transitions(tables):
    assert (tables.modes, tables.slots) == (3, 4)
    assert_array_equal(tables.transition, [[0, 2, 2, 0], [2, 2, 3, 6], [4, 5, 5, 0]])
    assert_array_equal(tables.component, [[0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    assert_array_equal(tables.directed, [[True, False, False, True], [False, False, True, True], [True] * 4])


def test_guards_fire_when_they_fall_and_the_padding_is_always_one(tables):
    expected = [[-7.0, -8.0, 2.5, 1.0], [-8.0, 2.5, -6.0, 6.0], [4.0, -8.0, 2.5, 1.0]]
    for guards, values in zip(tables.guards, expected, strict=True):
        assert_array_equal(guards(T, X), values)


def test_conditions_are_those_of_the_guards_and_flow_sets_have_never_one(tables):
    assert tables.shared
    expected = [[True, False, False, True], [False, False, True, False], [True, True, False, True]]
    for when, values in zip(tables.whens, expected, strict=True):
        assert_array_equal(when(T, X), values)


def test_clocks_are_armed_in_their_sources(tables):
    assert tables.clocks == (1,)
    assert_array_equal(tables.armed, [[True], [False], [True]])


def test_borders_of_flow_sets_and_what_only_records(tables):
    assert_array_equal(tables.borders, [[False] * 4, [False, False, False, True], [False] * 4])
    assert_array_equal(tables.recording, [[False] * 4, [False] * 4, [True, False, False, False]])


def test_fields_and_projections_of_the_modes(tables):
    for field, velocity in zip(tables.fields, [[3.0, 10.0, 0.0], [-2.0, -3.0, -4.0], [4.0, 6.0, 8.0]], strict=True):
        assert_array_equal(field(T, X), velocity)
    assert [one is None for one in tables.projections] == [True, False, True]
    assert_array_equal(tables.projections[1](T, X, X), 10 * X)
    assert not tables.constrained


def test_resets_and_targets_of_the_transitions(tables):
    after = [reset(T, X, WHICH) for reset in tables.resets]
    assert_array_equal(after, [X + 10, 3 * X, [2.0, 10.0, 4.0], X, X, X, X])
    targets = [target(MODE, T, X, WHICH) for target in tables.targets]
    assert_array_equal(targets, [1, 0, 2, 2, 0, 0, 0])
    assert {target.dtype for target in targets} == {MODE.dtype}
    assert int(tables.initial_mode(T, X)) == 1


def test_one_mode_alone_keeps_what_is_its_own(tables):
    for q in range(3):
        one = tables.of_mode(q)
        assert (one.modes, one.slots) == (1, 4)
        for name in ("directed", "transition", "component", "armed", "borders", "recording"):
            assert_array_equal(getattr(one, name), getattr(tables, name)[q : q + 1])
        for name in ("fields", "guards", "projections", "whens"):
            assert getattr(one, name) == (getattr(tables, name)[q],)
        for name in ("resets", "targets", "clocks"):
            assert getattr(one, name) == getattr(tables, name)


def test_what_no_transition_asks_for_is_none():
    reset = lambda t, x, a: -x  # noqa: E731
    plain = wire(lh.Hybrid(_moving, lh.Transition(lambda t, x, a: x[0], reset)), T, X, ARGS)
    assert (plain.borders, plain.recording, plain.initial_mode) == (None, None, None)
    assert (plain.modes, plain.slots, plain.shared, plain.armed.shape) == (1, 1, False, (1, 0))
    one = plain.of_mode(0)
    assert (one.borders, one.recording) == (None, None)
    assert_array_equal(plain.whens[0](T, X), [True])


def test_a_single_guard_of_full_width_is_taken_as_it_is():
    """Each concatenation is an equation that is traced and compiled once more a stage."""
    pair, one = lh.Transition(lambda t, x, a: x[:2] - a), lh.Transition(lambda t, x, a: x[2])
    guards = wire(lh.Hybrid(_moving, pair), T, X, ARGS).guards[0]
    assert "concatenate" not in str(jax.make_jaxpr(guards)(T, X))
    assert_array_equal(guards(T, X), [-8.0, -7.0])
    three = wire(lh.Hybrid(_moving, [pair, one]), T, X, ARGS)
    assert_array_equal(three.guards[0](T, X), [-8.0, -7.0, 4.0])
    assert_array_equal(three.recording, [[True] * 3])


def test_a_mode_without_guards_has_a_padding():
    clock = wire(lh.Hybrid(_moving, lh.Transition(every=0.5, reset=lambda t, x, a: -x)), T, X, ARGS)
    assert (clock.slots, clock.clocks) == (1, (0,))
    assert_array_equal(clock.guards[0](T, X), [1.0])
    assert_array_equal(clock.whens[0](T, X), [True])


def test_jumps_only():
    iterated = wire(lh.Hybrid(None, lh.Transition(lambda t, x, a: x[0], lambda t, x, a: a * x)), T, X, ARGS)
    assert iterated.fields == ()
    assert_array_equal(iterated.resets[0](T, X, WHICH), 10 * X)


def test_one_mode_needs_no_switch():
    one, two = (lambda x: x + 1), (lambda x: x - 1)
    assert "cond" not in str(jax.make_jaxpr(lambda x: by_mode(None, [one], x))(1.0))
    assert [float(by_mode(jnp.asarray(q), [one, two], 1.0)) for q in (0, 1)] == [2.0, 0.0]


# --- algebraic equations -------------------------------------------------------------------------------------------

SUM = lh.DAE(
    lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])),
    lambda t, x, a: jnp.stack([x[1], -a * x[0], x[2] - x[0] - x[1]]),
    n_differential=2,
)
RESET = lh.Transition(lambda t, x, a: x[0], lambda t, x, a: -x)


@pytest.mark.slow
def test_the_tangent_of_an_algebraic_mode_satisfies_its_equations():
    system = lh.Hybrid({"free": _moving, "bound": SUM}, RESET, tangent={"bound": lambda t, x, a, dx: a * dx})
    tables = wire(system, T, X, ARGS)
    assert tables.constrained
    assert [one is None for one in tables.projections] == [True, False]
    dx = jnp.asarray([1.0, 2.0, 5.0])
    assert_array_equal(tables.projections[1](T, X, dx), [10.0, 20.0, 30.0])  # the user's comes first
    assert_array_equal(projection(SUM.field, None, ARGS)(T, X, dx), [1.0, 2.0, 3.0])
    assert_array_equal(projection(tables.fields[1], None, ARGS)(T, X, dx), [1.0, 2.0, 3.0])
    assert not wire(lh.Hybrid({"free": _moving}, RESET), T, X, ARGS).constrained


def test_constant_equations_are_solved_once():
    field = wire(lh.Hybrid(SUM, RESET), T, X, ARGS).fields[0]
    assert isinstance(field, Bound)
    assert isinstance(field.field, Eliminated)
    np.testing.assert_allclose(field(T, X), [3.0, -20.0, -17.0])
