"""Names of the numbers in args: each verb that varies one knows it by the same name."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid._entries import described, entries, entry_named, entry_of


class Spring(NamedTuple):
    rate: float
    ends: jax.Array


ARGS = {
    "c": 2,
    "key": "not a number",
    "rates": jnp.array([1.0, 2.0, 3.0]),
    "spring": Spring(4.0, jnp.arange(6.0).reshape(2, 3)),
    "several": [5.0, (6.0, 7.0)],
    "odd[0]": 8.0,
    "words": np.array(["u", "v"]),
}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("c", 2),
        ("rates", [1.0, 2.0, 3.0]),
        ("rates[2]", 3.0),
        ("spring.rate", 4.0),
        ("spring.ends[1, 2]", 5.0),
        ("spring.ends[1,2]", 5.0),
        ("several.0", 5.0),
        ("several.1.1", 7.0),
        ("odd[0]", 8.0),
    ],
)
def test_each_number_has_a_name(name, value):
    entry = entry_of(ARGS, name)
    np.testing.assert_array_equal(entry.of(ARGS), value)
    other = entry.placed(ARGS, np.add(value, 10.0))
    np.testing.assert_array_equal(entry.of(other), np.add(value, 10.0))
    back = entry.placed(other, jnp.asarray(value, float))
    for one in entries(ARGS).values():  # and no other is changed
        np.testing.assert_array_equal(one.of(back), one.of(ARGS))


@pytest.mark.parametrize(
    "name",
    [
        "d",
        "rates[3]",
        "rates[-1]",
        "rates[",
        "rates[]",
        "rates[0",
        "rates[0, 0]",
        "rates[x]",
        "c[0]",
        "spring",
        "key",
        "words",
    ],
)
def test_what_is_not_there(name):
    assert entry_named(ARGS, name) is None
    with pytest.raises(ValueError, match=r"args has c, odd\[0\], rates \(rates\[0\] … rates\[2\]\)"):
        entry_of(ARGS, name)


@pytest.mark.parametrize(
    ("args", "name"), [({"a.b": 1.0, "a": {"b": 2.0}}, "a.b"), ({"r[0]": 1.0, "r": np.ones(2)}, "r[0]")]
)
def test_a_name_of_two_entries_is_refused(args, name):
    with pytest.raises(ValueError, match="2 entries of args have the name"):
        entry_of(args, name)


@pytest.mark.parametrize(("verb", "how"), [(lh.bifurcation_diagram, {"period": 1.0}), (lh.basin_shares, {"starts": 9})])
def test_an_array_is_no_parameter(verb, how):
    tilted = lh.Flow(lambda t, x, args: x - x**3 + jnp.sum(args["p"]))
    with pytest.raises(ValueError, match=r"'p' must be a single number, such as p\[0\]; got shape \(3,\)"):
        verb(tilted, [[-1.5], [1.5]], {"p": np.zeros(3)}, over={"p": [0.1]}, t1=99, key=jax.random.key(1), **how)


def test_args_that_are_one_number_or_an_array():
    assert entry_of(3.0, "args").placed(3.0, 4.0) == 4.0
    np.testing.assert_array_equal(entry_of(np.ones(2), "args[1]").placed(np.ones(2), 5.0), [1.0, 5.0])
    assert described(np.ones(2)) == "args (args[0] … args[1])"
    assert described(None) == described({}) == "nothing"


def test_large_arrays_are_not_written_out():
    assert described({"weights": np.zeros((1000, 1000))}) == "weights (weights[0, 0] … weights[999, 999])"


# x⁺ = p x (1 − x), and x' = −x + p with a kick: p is args["rates"][1].
LOGISTIC = lh.Map(lambda n, x, args: args["rates"][1] * x * (1 - x))
KEPT_AT = {"rates": np.array([0.0, 3.9])}


def test_every_verb_knows_an_entry_by_the_same_name():
    """At p = 3.2 the orbit of period two has the exponent ln|f'(x₁) f'(x₂)|/2 = ln|4 + 2p − p²|/2."""
    p, name = 3.2, "rates[1]"
    exact = np.log(abs(4 + 2 * p - p**2)) / 2
    how = {"period": 1, "t1": 100, "transient": 200, "directions": ("up",)}
    diagram = lh.bifurcation_diagram(LOGISTIC, [0.4], KEPT_AT, over={name: [p]}, **how)
    assert abs(float(np.ravel(diagram.exponents)[0]) - exact) < 1e-9

    swept = lh.sweep(
        lambda args: lh.lyapunov_spectrum(LOGISTIC, [0.4], args, t1=100, transient=200), args=KEPT_AT, over={name: [p]}
    )
    assert abs(float(np.ravel(swept.exponents)[0]) - exact) < 1e-9

    gradient = lh.lyapunov_gradient(LOGISTIC, [0.4], {"rates": np.array([0.0, p])}, t1=100, transient=200)
    assert gradient.names == ("rates[0]", name)
    branch = lh.continuation(LOGISTIC, [0.5], {"rates": np.array([0.0, 2.0])}, over={name: (1.9, 2.1)}, period=1)
    assert branch.parameter == name


def test_shares_of_basins_along_an_entry_of_an_array():
    """x' = x − x³ + p with p = 0.1: starts above the middle root of x − x³ + p, −0.10103, go up."""
    tilted = lh.Flow(lambda t, x, args: x - x**3 + args["rates"][1])
    found = lh.basin_shares(
        tilted, [[-1.5], [1.5]], KEPT_AT, over={"rates[1]": [0.1]}, t1=60.0, starts=400, key=jax.random.key(1)
    )
    up = int(found.basins[0].attractors[1].points[0, 0] > 0)
    assert abs(found.shares[0, up] - (1.5 + 0.10103) / 3) < 4 * found.stderr.max()
    assert found.parameter == "rates[1]"


@pytest.mark.filterwarnings("ignore:x0 is float32")
def test_states_of_single_precision():
    logistic, how = lh.Map(lambda n, x, args: args["p"] * x * (1 - x)), {"t1": 100, "transient": 100, "period": 1}
    with jax.numpy_dtype_promotion("standard"):
        diagram = lh.bifurcation_diagram(
            logistic, np.array([0.4], np.float32), {"p": 3.9}, over={"p": [3.2]}, directions=("up",), **how
        )
    assert abs(float(np.ravel(diagram.exponents)[0]) - np.log(abs(4 + 2 * 3.2 - 3.2**2)) / 2) < 1e-4
