"""The compiler switch: set on import, never over the user's choice, and worth having."""

import functools
import os
import subprocess
import sys
import time

import jax
import numpy as np
import pytest
from jax._src import xla_bridge

import lyaphybrid as lh
from lyaphybrid import _compiler, runs
from lyaphybrid._compiler import compilations, lean_jit, request_single_kernel_loops

KERNELS = "xla_cpu_small_while_loop_byte_threshold=16777216"
UNROLLING = "-unroll-full-max-count=3"
OPTION = f"{KERNELS},{UNROLLING},-available-load-scan-limit=1000"
SWITCH = f"--xla_backend_extra_options={OPTION}"
LOOP = """
import jax, jax.numpy as jnp
from lyaphybrid._compiler import compiles_to_one_kernel
def loop(f):
    return lambda m: jax.lax.while_loop(lambda c: c[0] < 9, lambda c: (c[0] + 1, f(c[1])), (0, m))[1]
def nest(finish, n=12):  # 12: too large for the default threshold, which takes (3, 3)
    inner = loop(lambda m: m * 1.01 + m.T)
    return compiles_to_one_kernel(jax.jit(loop(lambda m: finish(inner(m)))).lower(jnp.eye(n)).compile())
normalise = lambda m: m / jnp.sqrt(1 + jnp.sum(m * m))
"""


def python(code: str, **environment: str) -> subprocess.CompletedProcess:
    """Run `code` where no JAX backend exists yet."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "LYAPHYBRID_KEEP_XLA_FLAGS")}
    environment = inherited | {"JAX_PLATFORMS": "cpu"} | environment
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


def test_import_sets_the_switch_and_loops_become_one_kernel():
    done = python("import os, jax, lyaphybrid" + LOOP + "print(os.environ['XLA_FLAGS'], nest(normalise))")
    assert done.stdout.split() == [SWITCH, "True"]


def lorenz_kernel(folder, options=""):
    """The kernel of a Lorenz spectrum, in LLVM's language, with our options or with others."""
    code = "import lyaphybrid as lh; lh.zoo.lorenz63().spectrum(t1=1.0, method=lh.RungeKutta('rk4', dt=0.01))"
    flags = f"--xla_dump_to={folder} --xla_dump_hlo_as_text"
    if jax.__version_info__ >= (0, 11):  # these write no code without being asked; 0.8 does not know the flag
        flags += " --xla_dump_emitter_re=llvm.*"
    python(code, XLA_FLAGS=f"--xla_backend_extra_options={options} {flags}" if options else flags, JAX_ENABLE_X64="1")
    (kernel,) = folder.glob("*_advance*call*computation_kernel_module.ir-with-opt.ll")
    return kernel.read_text()


def test_three_columns_become_vector_code(tmp_path):
    ours, first = lorenz_kernel(tmp_path / "ours"), lorenz_kernel(tmp_path / "first", KERNELS)
    assert ours.count(" x double>") > 2 * first.count(" x double>") + 50


def test_rows_are_not_read_back_from_memory(tmp_path):
    ours, two = lorenz_kernel(tmp_path / "ours"), lorenz_kernel(tmp_path / "two", f"{KERNELS},{UNROLLING}")
    assert 2 * ours.count("load <4 x double>") < two.count("load <4 x double>")


def test_opting_out_leaves_the_flags_as_they_were():
    done = python("import os, lyaphybrid; print(os.environ.get('XLA_FLAGS'))", LYAPHYBRID_KEEP_XLA_FLAGS="1")
    assert done.stdout.split() == ["None"]


def test_the_users_threshold_has_its_effect():
    small = SWITCH.replace("16777216", "16")  # bytes: no loop of arrays is that small
    done = python("import os, lyaphybrid" + LOOP + "print(os.environ['XLA_FLAGS'], nest(normalise))", XLA_FLAGS=small)
    assert done.stdout.split() == [small, "False"]


def test_a_refused_option_is_asked_for_once(monkeypatch):
    monkeypatch.setattr("lyaphybrid._compiler._LEAN", {"xla_of_the_future": True} | _compiler._LEAN)
    monkeypatch.setattr("lyaphybrid._compiler._known_options", functools.cache(_compiler._known_options.__wrapped__))
    asked = []

    def is_known(option, value, ask=_compiler._is_known):
        asked.append(option)
        return ask(option, value)

    monkeypatch.setattr("lyaphybrid._compiler._is_known", is_known)
    double, triple = lean_jit(lambda x: 2 * x), lean_jit(lambda x: 3 * x)
    assert [double(2.0), double(3.0), triple(2.0), triple(np.ones(2)).tolist()] == [4, 6, 6, [3, 3]]
    assert asked == list(_compiler._LEAN)
    assert "xla_of_the_future" not in _compiler._known_options()


SECOND_CALLS = {
    "flow": ("lorenz63", {"t1": 5.0}),
    "impacts": ("impact_oscillator", {"t1": 20.0}),
    "map": ("henon_map", {"t1": 100}),
    "disks": ("hard_disks", {"t1": 5.0}),
}


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


def test_compiling_does_not_make_calls_shorter(monkeypatch):
    """A call that compiled took long for that reason: the next one has the same budget, not a smaller one."""
    budgets = []

    def slow_at_first(*args, advance=runs._advance):
        budgets.append(int(args[-1]))
        if len(budgets) == 1:
            jax.jit(lambda x: x * 1.125)(2.0)  # compiles, and takes long
            time.sleep(2 * runs.SECONDS_PER_CALL)
        return advance(*args)

    problem = lh.zoo.lorenz63()
    keywords = {"t1": 400.0, "method": lh.RungeKutta("rk4", dt=0.01)}
    problem.spectrum(**keywords)
    monkeypatch.setattr(runs, "_advance", slow_at_first)
    problem.spectrum(**keywords)
    assert budgets[1] == budgets[0]
    assert budgets[2] > 2 * budgets[1]


def test_xla_takes_the_merged_flags():
    user = "--xla_backend_extra_options='xla_cpu_mine=1' --xla_force_host_platform_device_count=2"
    done = python("import lyaphybrid" + LOOP + "print(nest(normalise), jax.device_count())", XLA_FLAGS=user)
    assert done.stdout.split() == ["True", "2"]


def test_a_loop_with_lapack_inside_is_not_one_kernel():
    done = python("import lyaphybrid" + LOOP + "print(nest(lambda m: jnp.linalg.qr(m)[0]))")
    assert done.stdout.split() == ["False"]


def test_too_late_warns_once_and_says_what_to_do():
    code = "import jax, os; jax.devices(); import lyaphybrid; print(os.environ.get('XLA_FLAGS'))"
    done = python(code)
    assert done.stdout.split() == ["None"]
    assert done.stderr.count("UserWarning") == 1
    assert "import lyaphybrid before the first JAX computation" in done.stderr
    assert SWITCH in done.stderr
    assert "<string>:1: UserWarning" in done.stderr  # points at the user's line
    assert "UserWarning" not in python(code, LYAPHYBRID_KEEP_XLA_FLAGS="1").stderr
    assert "UserWarning" not in python(code, XLA_FLAGS=SWITCH).stderr


@pytest.fixture
def no_backend(monkeypatch):
    monkeypatch.setattr(xla_bridge, "backends_are_initialized", lambda: False)
    monkeypatch.delenv("LYAPHYBRID_KEEP_XLA_FLAGS", raising=False)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", SWITCH),
        ("--xla_dump_to=dump", f"--xla_dump_to=dump {SWITCH}"),
        ("--xla_backend_extra_options=a=1,b --x=2", f"--xla_backend_extra_options={OPTION},a=1,b --x=2"),
        ('--xla_backend_extra_options="a=1"', f'--xla_backend_extra_options="{OPTION},a=1"'),
        (SWITCH.replace("16777216", "0"), SWITCH.replace("16777216", "0")),
        (SWITCH, SWITCH),
    ],
)
def test_merging_with_the_users_flags(no_backend, monkeypatch, before, after):
    monkeypatch.setenv("XLA_FLAGS", before)
    request_single_kernel_loops()
    assert os.environ["XLA_FLAGS"] == after


def test_a_flags_file_is_left_alone(no_backend, monkeypatch, tmp_path):
    file = tmp_path / "flags"
    file.write_text("--xla_cpu_enable_fast_math=false")
    monkeypatch.setenv("XLA_FLAGS", str(file))
    with pytest.warns(UserWarning, match="to the file that XLA_FLAGS names"):
        request_single_kernel_loops()
    file.write_text(SWITCH)
    request_single_kernel_loops()
    assert os.environ["XLA_FLAGS"] == str(file)


def test_only_a_cpu_is_warned_about(no_backend, monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    monkeypatch.setattr(xla_bridge, "backends_are_initialized", lambda: True)
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    request_single_kernel_loops()
    assert "XLA_FLAGS" not in os.environ


def test_other_devices_do_not_get_llvms_option(no_backend, monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name == "jax_plugins")
    request_single_kernel_loops()
    assert os.environ["XLA_FLAGS"] == f"--xla_backend_extra_options={KERNELS}"


def test_an_old_jax_is_left_alone(no_backend, monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    monkeypatch.setattr("jax.__version_info__", (0, 7, 2))
    request_single_kernel_loops()
    assert "XLA_FLAGS" not in os.environ
