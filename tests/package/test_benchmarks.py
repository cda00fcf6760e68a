"""The C that the benchmarks compare with is fair: what it is compiled to, not only what is said about it."""

import numpy as np
import pytest

import lyaphybrid as lh
from benchmarks import first_calls, lattices, many_disks, problems, references


@pytest.fixture(autouse=True)
def needs_a_compiler():
    """The package needs none, only the comparison: as in `python -m benchmarks`, the reason is said (pytest -rs)."""
    try:
        references.compiler()
    except references.NoCompilerError as reason:
        pytest.skip(str(reason))


@pytest.mark.slow
def test_the_c_computes_what_is_known():
    assert [check.name for check in references.validate() if not check.passed] == []


@pytest.mark.slow
def test_the_c_of_many_disks_computes_what_is_known():
    assert [check.name for check in many_disks.validate() if not check.passed] == []


@pytest.mark.slow
def test_both_sides_of_henon_and_heiles_agree():
    method, start = lh.Symplectic("SBAB2C", dt=problems.HENON_HEILES_DT), np.array(problems.HENON_HEILES_START)
    found = lh.zoo.henon_heiles().spectrum(x0=start, t1=60.0, method=method, every=10, blocks=2)
    other = references.run_henon_heiles(60.0, every=10)
    np.testing.assert_allclose(found.x, other.x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.exponents, np.sort(other.exponents)[::-1], rtol=0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", lattices.NAMES)
def test_both_sides_of_a_lattice_agree(name):
    problem = lh.zoo.get(name)(n=20)
    found = problem.spectrum(t1=20.0, every=10, blocks=2, frame=lattices.columns(20, 3))
    other = lattices.run_lattice(name, 20, 3, 10, 20.0)
    np.testing.assert_allclose(found.x, other.x, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.exponents, np.sort(other.exponents)[::-1], rtol=0, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("adaptive", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_both_sides_of_the_friction_pendulum_agree(adaptive):
    from benchmarks import ours

    if adaptive:
        method, every = lh.RungeKutta("dopri5", problems.FRICTION_RTOL, problems.FRICTION_ATOL), 0.3
    else:
        method, every = lh.RungeKutta("rk4", dt=problems.FRICTION_DT), problems.FRICTION_EVERY
    start, args = np.array(problems.FRICTION_START), problems.FRICTION_PARAMETERS
    found = lh.lyapunov_spectrum(ours.RUBBED, start, args, t1=30.0, transient=0.0, method=method, every=every)
    other = references.run_friction(30.0, adaptive)
    assert found.jumps == other.events == 3
    np.testing.assert_allclose(found.x, other.x, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.exponents, other.exponents, rtol=0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("continuous", [False, True])
def test_both_sides_of_the_spring_damper_agree(continuous):
    method = lh.HalfExplicit(rtol=problems.SPRING_TOL, atol=problems.SPRING_TOL)  # as the C controls errors
    problem = lh.zoo.spring_damper_dae(**problems.SPRING_PARAMETERS)
    start, method = np.array(problems.SPRING_START), lh.ContinuousQR(method) if continuous else method
    found = problem.spectrum(x0=start, t1=100.0, transient=0.0, k=2, method=method, blocks=2)
    other = references.run_spring_damper(100.0, continuous)
    np.testing.assert_allclose(found.exponents, other.exponents, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.abs(found.frame), np.abs(other.frame), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_both_sides_of_the_spring_damper_sweep_agree():
    from benchmarks import ours

    found = ours.dampings_swept(np.linspace(*problems.SPRING_DAMPINGS, 3))
    np.testing.assert_allclose(found, references.run_spring_damper_sweep(3).exponents, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_the_c_takes_square_roots_by_an_instruction(tmp_path):
    # A call that may set errno in a loop costs the hard disks a factor of 2.7, and flattered our ratios once.
    careless = tuple(flag for flag in references.FLAGS if flag != "-fno-math-errno")
    for name, flags, calls in (("careless", careless, True), ("ours", references.FLAGS, False)):
        references.build(str(tmp_path / name), flags)
        assert (b"\0sqrt\0" in (tmp_path / name).read_bytes()) is calls, name  # the first: that it would be seen


@pytest.mark.slow
def test_first_calls_are_measured(tmp_path):
    found = first_calls.in_a_process("cat_map", str(tmp_path / "code"), str(tmp_path / "bytes"))
    assert 0 < found["second"] < found["first"]


@pytest.mark.slow
def test_steps_of_a_stiff_flow_are_counted():
    from benchmarks import stiff

    found = {name: stiff.measure("robertson", 3, method) for name, method in stiff.methods(3).items()}
    explicit = found.pop("explicit")
    for name, one in found.items():
        assert 100 < one.attempts < explicit.attempts / 500, name
        np.testing.assert_allclose(one.exponents, explicit.exponents, rtol=1e-6)
