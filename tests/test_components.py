"""A loop written in numbers and rows does what the loop of arrays does."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import compiled_loop
from lyaphybrid.components import by_components, joined, split

A = jnp.array([[0.3, -1.2], [0.7, 0.4]])
STATE = {"x": jnp.array([0.4, -0.9]), "frame": jnp.array([[1.0, 0.2, 3.0], [-0.5, 2.0, 0.1]]), "h": jnp.array(0.01)}


def changed(**new):
    return STATE | new


def turned(x):
    return jnp.stack([x[1], -x[0]])


FUNCTIONS = {
    "arithmetic": lambda s: s | {"x": s["x"] + s["h"] * turned(s["x"]) ** 2 / 3.0},
    "columns": lambda s: s | {"frame": s["frame"] + s["h"] * s["x"][:, None] * s["frame"][::-1]},
    "rows": lambda s: s | {"frame": jnp.stack([s["frame"][1], s["x"][0] * s["frame"][0]])},
    "row of numbers": lambda s: s | {"frame": s["frame"] * jnp.array([s["h"], 2.0, s["x"][0]])[None, :]},
    "numbers of a column": lambda s: s | {"x": s["frame"][:, 1]},
    "matrix": lambda s: s | {"x": A @ s["x"], "frame": A @ s["frame"]},
    "transposed": lambda s: s | {"frame": (s["frame"].T @ A).T},
    "sums": lambda s: s | {"x": jnp.sum(s["frame"], axis=1), "h": jnp.sum(s["frame"]) + jnp.max(s["x"])},
    "sum of rows": lambda s: s | {"frame": s["frame"] - jnp.sum(s["frame"], axis=0)[None, :]},
    "smallest": lambda s: (
        s | {"h": jnp.where(jnp.all(jnp.isfinite(s["x"])) & jnp.any(s["x"] > 0), jnp.min(s["frame"]), 9.0)}
    ),
    "choice": lambda s: s | {"x": jnp.where(s["x"] > 0, s["x"], -1.0), "frame": jnp.where(s["h"] > 0, s["frame"], 0)},
    "bounds": lambda s: s | {"x": jnp.clip(s["x"], -0.5, s["h"])},
    "custom derivative": lambda s: s | {"x": jax.nn.softplus(s["x"]) + jax.nn.relu(s["x"])},
    "conditional": lambda s: s | {"x": jax.lax.cond(s["h"] > 0, jnp.sin, jnp.cos, s["x"])},
    "rolled": lambda s: s | {"x": jnp.roll(s["x"], 1), "frame": jnp.roll(s["frame"], 1, axis=1)},
    "flattened": lambda s: s | {"frame": s["frame"].reshape(-1)[::-1].reshape(2, 3)},
    "by columns": lambda s: s | {"frame": s["frame"].reshape((2, 3), order="F") * s["h"]},
    "by columns, a vector": lambda s: s | {"x": s["frame"][:, :2].reshape(4, order="F")[1:3]},
    "integers": lambda s: s | {"h": s["h"] * jnp.sum(jnp.sign(s["frame"]).astype(jnp.int32)).astype(s["h"].dtype)},
    "nothing": lambda s: s | {"x": s["x"] + jnp.sum(s["frame"][:, :0], axis=1)},
    "alone": lambda s: s | {"x": jnp.concatenate([s["x"][1:], jnp.array([2.0])])},
    "norms": lambda s: s | {"frame": s["frame"] / jnp.linalg.norm(s["frame"], axis=0)[None, :]},
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_by_components_is_the_function(name):
    function = FUNCTIONS[name]
    found = joined(by_components(function, STATE)(split(STATE)), STATE)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-15), found, function(STATE))
    assert jax.tree.map(jnp.shape, found) == jax.tree.map(jnp.shape, STATE)


def test_small_arrays_alone_are_split():
    leaves = split([jnp.ones(4), jnp.ones(5), jnp.ones(0), jnp.ones(()), jnp.ones((3, 9)), jnp.ones((5, 2))])
    assert [len(leaf) if isinstance(leaf, tuple) else leaf.shape for leaf in leaves] == [4, (5,), (0,), (), 3, (5, 2)]


def test_by_components_can_be_differentiated_and_mapped():
    def of_x(x):
        return joined(by_components(FUNCTIONS["arithmetic"], changed(x=x))(split(changed(x=x))), STATE)["x"]

    direct = jax.jacfwd(lambda x: FUNCTIONS["arithmetic"](changed(x=x))["x"])
    np.testing.assert_allclose(jax.jacfwd(of_x)(STATE["x"]), direct(STATE["x"]), rtol=1e-15)
    several = jnp.stack([STATE["x"], 2 * STATE["x"], -STATE["x"]])
    np.testing.assert_allclose(jax.vmap(of_x)(several), jnp.stack([of_x(x) for x in several]), rtol=1e-15)


def test_effects_stay(capfd):
    def told(s):
        jax.debug.print("h is {}", s["h"])
        return s

    by_components(told, STATE)(split(STATE))
    jax.effects_barrier()
    assert capfd.readouterr().out == "h is 0.01\n"


class InArrays(lh.RungeKutta):
    """A method whose loops are not written in numbers."""

    def does_little(self, n):
        return False


def impacts(method, **keywords):
    problem = lh.zoo.impact_oscillator()
    return lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, t1=30.0, method=method, **keywords)


def test_a_run_in_numbers_is_the_run_in_arrays():
    numbers, arrays = impacts(lh.RungeKutta("rk4", dt=0.01)), impacts(InArrays("rk4", dt=0.01))
    assert numbers.jumps == arrays.jumps > 5
    np.testing.assert_allclose(numbers.exponents, arrays.exponents, rtol=1e-9)
    np.testing.assert_allclose(numbers.x, arrays.x, rtol=1e-9)


def test_the_loop_of_an_oscillator_carries_numbers(monkeypatch):
    def arrays_in_loops(method):
        problem = lh.zoo.impact_oscillator()
        loop = compiled_loop(monkeypatch, problem.system, problem.x0, problem.args, t1=2.0, blocks=4, method=method)
        loops = " ".join(re.findall(r" = \((.*)\) while\(", loop.as_text()))
        return loops.count("f64[2]{") + loops.count("f64[2,2]")

    assert arrays_in_loops(lh.RungeKutta("rk4", dt=0.01)) < arrays_in_loops(InArrays("rk4", dt=0.01))
