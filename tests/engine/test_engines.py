"""What runs a loop: compiled once, natively or by XLA, with the same results; and how compiling is counted."""

import functools
import os
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid._jax import engines as _engines
from lyaphybrid._jax.engines import compilations
from lyaphybrid.engine.host import driver

SECOND_CALLS = {
    "flow": ("lorenz63", {"t1": 5.0}),
    "impacts": ("impact_oscillator", {"t1": 20.0}),
    "map": ("henon_map", {"t1": 100}),
    "disks": ("hard_disks", {"t1": 5.0}),
}


@pytest.mark.slow_cases("disks", "impacts")
@pytest.mark.parametrize("name", SECOND_CALLS)
def test_a_second_call_compiles_nothing(name):
    problem, keywords = SECOND_CALLS[name]
    problem = getattr(lh.zoo, problem)()
    first = problem.spectrum(**keywords)
    before = compilations()
    second = problem.spectrum(**keywords)
    longer = problem.spectrum(**(keywords | {"t1": 3 * keywords["t1"]}))
    assert compilations() == before
    np.testing.assert_array_equal(second.exponents, first.exponents)
    assert longer.time > second.time


def test_compilations_are_counted():
    before = compilations()
    fresh = jax.jit(lambda x: x * 1.25)
    assert [float(fresh(2.0)), float(fresh(4.0)), compilations() - before] == [2.5, 5.0, 1]


@pytest.mark.slow
def test_compiling_does_not_make_calls_shorter(monkeypatch):
    """A call that compiled took long for that reason: the next one has the same budget, not a smaller one."""
    budgets = []

    @functools.wraps(driver._advance)
    def slow_at_first(*args, advance=driver._advance):
        budgets.append(int(args[-1]))
        if len(budgets) == 1:
            jax.jit(lambda x: x * 1.125)(2.0)  # compiles, and takes long
            time.sleep(2 * driver.SECONDS_PER_CALL)
        return advance(*args)

    problem = lh.zoo.lorenz63()
    keywords = {"t1": 400.0, "method": lh.RungeKutta("rk4", dt=0.01)}
    problem.spectrum(**keywords)
    monkeypatch.setattr(driver, "_advance", slow_at_first)
    problem.spectrum(**keywords)
    assert budgets[1] == budgets[0]
    assert budgets[2] > 2 * budgets[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", SECOND_CALLS)
def test_both_engines_compute_the_same(name, monkeypatch):
    problem, keywords = SECOND_CALLS[name]
    problem, found = getattr(lh.zoo, problem)(), {}
    for engine in ("native", "xla"):
        monkeypatch.setenv("LYAPHYBRID_ENGINE", engine)
        found[engine] = problem.spectrum(**(keywords | {"t1": keywords["t1"] / 5, "transient": 0.0}))
    assert found["native"].jumps == found["xla"].jumps
    np.testing.assert_allclose(found["native"].exponents, found["xla"].exponents, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found["native"].x, found["xla"].x, rtol=1e-6, atol=1e-9)


DECAY = lh.Flow(lambda t, x, a: jnp.stack([-a * x[0] + jnp.sin(x[1]), -x[1]]))
FEW_STAGES = lh.RungeKutta("rk4", dt=0.5)  # XLA compiles each stage many times over


def decay(a):
    return lh.lyapunov_spectrum(DECAY, [0.3, 0.1], a, t1=4.0, transient=0.0, blocks=2, method=FEW_STAGES).exponents


TRANSFORMED = {
    "jit": jax.jit,
    "jacfwd": jax.jacfwd,
    "jacrev": jax.jacrev,
    "jit of jacrev": lambda f: jax.jit(jax.jacrev(f)),
    "vmap": lambda f: lambda a: jax.vmap(f)(a * jnp.linspace(0.5, 1.0, 3)),
    "vmap of jacfwd": lambda f: lambda a: jax.vmap(jax.jacfwd(f))(a * jnp.linspace(0.5, 1.0, 3)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TRANSFORMED)
def test_transformations_call_machine_code(name, monkeypatch):
    found = {}
    for engine in ("native", "xla"):
        monkeypatch.setenv("LYAPHYBRID_ENGINE", engine)
        found[engine] = TRANSFORMED[name](lambda a: decay(a))(0.7)
    np.testing.assert_allclose(found["native"], found["xla"], rtol=1e-8, atol=1e-10)


@pytest.mark.slow
def test_what_a_function_closes_over_is_left_to_xla(monkeypatch):
    natively, call = [], _engines._Natively.__call__

    def noted(self, *args):
        natively.append(self.function.__name__)
        return call(self, *args)

    monkeypatch.setattr(_engines._Natively, "__call__", noted)

    def closed(a):
        flow = lh.Flow(lambda t, x, args: -a * x)
        method = lh.RungeKutta("rk4", dt=0.05)
        return lh.lyapunov_spectrum(flow, [0.3], t1=4.0, transient=0.0, blocks=2, method=method).exponents

    np.testing.assert_allclose(jax.jacfwd(closed)(0.7), [-1.0], rtol=1e-6)
    assert set(natively) <= {"restart", "_verdict", "_together"}  # what does not see the field


@pytest.mark.slow
def test_an_import_sets_nothing():
    code = "import os, jax, lyaphybrid; print(os.environ.get('XLA_FLAGS'), jax.config.jax_enable_x64)"
    clean = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, env=clean)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["None", "False"]


@pytest.mark.parametrize("order", [(True, 1), (1, True)])
def test_numbers_that_are_equal_are_not_of_one_type(order):
    """~True is False and ~1 is −2: a program of the one is none of the other."""
    rule = lh.Map(lambda n, x, args: jnp.where(~jnp.asarray(args["free"]), 2.0, 3.0) * x)
    found = {type(free): float(lh.lyapunov_spectrum(rule, [0.3], {"free": free}, t1=10).exponents[0]) for free in order}
    assert found[bool] == pytest.approx(np.log(3.0), abs=1e-12)
    assert found[int] == pytest.approx(np.log(2.0), abs=1e-12)
