"""A system is compiled once: derivatives at other parameters, starts and lengths compile nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from known_gradients import TORUS, sheared_hopf, torus
from lyaphybrid._jax.engines import compilations

HOPF, CIRCLES = lh.Flow(sheared_hopf), lh.Map(torus)
LOGISTIC = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
SADDLE = lh.Map(lambda n, x, a: jnp.stack([a * x[0] * (1 - x[0]) + 0.01 * x[1], 0.3 * x[1] + 0.1 * x[0]]))
IMPACTS = lh.zoo.impact_oscillator(omega=2.3, zeta=0.02, restitution=0.8, gap=0.0)


def gradient(system, x0, args, **keywords):
    return lh.lyapunov_gradient(system, x0, args, **keywords)


def turn_of(args):
    return 2 * np.pi / args["omega"]


def of_impacts(i, **keywords):
    args = IMPACTS.args | {"omega": 2.3 + 0.01 * i, "restitution": 0.8 - 0.01 * i}
    options = {"t1": 100.0 + i, "transient": 60.0 + i, "period": turn_of}
    return lh.lyapunov_gradient(IMPACTS.system, np.asarray(IMPACTS.x0) * (1 + 0.1 * i), args, **(options | keywords))


def of_design(i, **keywords):
    options = {"t1": 1000 + i, "over": "r"}
    return lh.design(LOGISTIC, [0.3 + 0.01 * i], {"r": 2.8 + 0.01 * i}, -0.5 - 0.01 * i, **(options | keywords))


CALLS = {
    "implicit, of a flow": lambda i: gradient(
        HOPF, [0.9, 0.1 * i], 0.8 + 0.1 * i, t1=50.0 + i, transient=50.0 + i, algorithm="implicit"
    ),
    "implicit, of a map": lambda i: gradient(LOGISTIC, [0.3 + 0.1 * i], {"r": 3.3 + 0.1 * i}, t1=1000 + i),
    "implicit, with impacts": lambda i: of_impacts(i, algorithm="implicit"),
    "birkhoff, of a map": lambda i: gradient(
        CIRCLES, [0.3 + 0.1 * i, 0.1], {**TORUS, "depth": 0.3 + 0.1 * i}, t1=2000, transient=200 + i,
        algorithm="birkhoff",
    ),
    "birkhoff, of a flow": lambda i: gradient(
        HOPF, [0.9, 0.1 * i], 0.8 + 0.1 * i, t1=60.0 + i, transient=50.0 + i, algorithm="birkhoff"
    ),
    "regression": lambda i: gradient(
        LOGISTIC, [0.3], {"r": 3.9 + 0.01 * i}, t1=500 + i, transient=50 + i, algorithm="regression",
        key=jax.random.key(i), window=0.01,
    ),
    "linear response": lambda i: gradient(
        SADDLE, [0.3, 0.1], 3.9 + 0.01 * i, t1=1024, transient=50 + i, algorithm="linear_response",
        key=jax.random.key(i),
    ),
    "design": of_design,
    "design by an objective": lambda i: lh.design(
        LOGISTIC, [0.3], {"r": 2.8}, lambda found, args: (found[0] + 0.5 + 0.01 * i) ** 2, t1=1000, over="r", steps=3
    ),
    "design by bisection": lambda i: of_design(i, optimiser="bisection", over={"r": (2.2, 2.95)}, steps=5),
}  # fmt: skip


@pytest.mark.slow_cases(
    all_but=(
        "implicit, of a map",
        "design",
        "design by an objective",
        "design by bisection",
    )
)
@pytest.mark.parametrize("name", CALLS)
def test_a_second_call_compiles_nothing(name):
    CALLS[name](0)
    before = compilations()
    CALLS[name](1)
    assert compilations() == before


def test_the_count_sees_what_is_compiled():
    """A new function is a new system."""
    before = compilations()
    lh.lyapunov_gradient(lh.Map(lambda n, x, r: r * x * (1 - x)), [0.3], 2.9, t1=100)
    assert compilations() > before


@pytest.mark.slow
def test_other_numbers_of_jumps_compile_nothing():
    of_impacts(0, algorithm="birkhoff", period=None, t1=4000.0)
    before = compilations()
    of_impacts(1, algorithm="birkhoff", period=None, t1=4030.0)
    assert compilations() == before
