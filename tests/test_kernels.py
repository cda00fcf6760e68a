"""The loops of three small problems compile to one native kernel each: no LAPACK, no scatter, no callback inside."""

import jax
import numpy as np
import pytest

import lyaphybrid as lh
from examples import compiled_loop
from lyaphybrid._compiler import compiles_to_one_kernel

CASES = {
    "Lorenz, RK4": ("lorenz63", {"method": lh.RungeKutta("rk4", dt=0.01), "every": 1}),
    "impact oscillator, adaptive": ("impact_oscillator", {"method": lh.RungeKutta("dopri5")}),
    "hard disks": ("hard_disks", {"every": 10}),
}


@pytest.mark.parametrize("case", [*list(CASES)[:2], pytest.param("hard disks", marks=pytest.mark.slow)])
def test_the_loop_is_one_kernel(case, monkeypatch):
    """What the driver calls, compiled, holds no loop that is dispatched operation by operation."""
    name, keywords = CASES[case]
    problem = getattr(lh.zoo, name)()
    loop = compiled_loop(monkeypatch, problem.system, problem.x0, problem.args, t1=2.0, blocks=4, **keywords)
    assert jax.default_backend() == "cpu"
    assert compiles_to_one_kernel(loop)


@pytest.mark.parametrize(("name", "method"), [("lorenz63", lh.RungeKutta("rk4", dt=0.01)), ("henon_map", None)])
def test_orthonormalising_after_each_step_needs_no_loop_of_steps(name, method, monkeypatch):
    problem = getattr(lh.zoo, name)()
    keywords = {"t1": 20.0, "blocks": 4, "method": method}

    def run(every):
        return lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, every=every, **keywords).exponents

    def loops(every):
        loop = compiled_loop(monkeypatch, problem.system, problem.x0, problem.args, every=every, **keywords)
        return loop.as_text().count(" while(")

    assert loops(1) == loops(2) - 1
    # As a traced number it may be anything, and the loop stays; rounding grows by e^18.
    np.testing.assert_allclose(run(1), jax.jit(run)(1.0), rtol=1e-7)
