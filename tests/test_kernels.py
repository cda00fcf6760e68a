"""The loops of three small problems compile to one native kernel each: no LAPACK, no scatter, no callback inside."""

import jax
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
