"""The text that is emitted: valid for other machines, short, the same each time, and within bounds of its arrays."""

import ctypes
import functools
import random
import subprocess
import sys

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest
from jax import lax
from test_each_primitive import ARRAYS

from against_xla import differences
from lyaphybrid import native
from lyaphybrid.native import Compiled
from lyaphybrid.native.lowering.costs import Options, runs_long
from lyaphybrid.native.lowering.emitter import Emitter
from lyaphybrid.native.lowering.lowering import lower
from lyaphybrid.native.machine.code import Linked
from lyaphybrid.native.machine.emission import object_code
from random_programs import random_program

TRIPLES = (
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "arm64-apple-macosx14.0.0",
    "x86_64-pc-windows-msvc",
)


@functools.cache
def _trace(case):
    function, operands = ARRAYS[case]
    return jax.make_jaxpr(function)(*operands)


@pytest.mark.slow
@pytest.mark.parametrize("triple", TRIPLES)
def test_machine_code_for_other_machines(triple):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(opt=1, reloc="pic")
    for case in ("whiles", "branches", "aliases", "products"):
        for small in (1, 16):
            module = llvm.parse_assembly(lower(_trace(case), small, checked=small == 1))
            module.triple, module.data_layout = triple, str(machine.target_data)
            module.verify()
            builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
            builder.getModulePassManager().run(module, builder)
            assert len(machine.emit_object(module)) > 1000


def test_one_program_has_one_text():
    for case in ("aliases", "whiles"):
        assert lower(_trace(case), 4) == lower(_trace(case), 4)


# --- length ----------------------------------------------------------------------------------------------------------


def _lorenz96(x):
    return jnp.roll(x, 1) * (jnp.roll(x, -1) - jnp.roll(x, 2)) - x + 8.0


def _step(x, frame):
    """A step of RK4 of a state and of all its tangent vectors."""

    def push(x):
        k1 = _lorenz96(x)
        k2 = _lorenz96(x + 0.005 * k1)
        k3 = _lorenz96(x + 0.005 * k2)
        return x + 0.01 / 6 * (k1 + 2 * k2 + 2 * k3 + _lorenz96(x + 0.01 * k3))

    return jax.vmap(lambda v: jax.jvp(push, (x,), (v,)), out_axes=(None, 0))(frame)


@pytest.mark.parametrize(("n", "k"), [(40, 40), (1000, 1000)])
def test_code_of_many_variables_is_short(n, k):
    x = 8 + np.sin(np.arange(n))
    compiled = Compiled(jax.make_jaxpr(_step)(x, np.eye(k, n)))
    assert compiled.text.count("\n") < 6000
    if n == 40:
        assert not differences(_step, x, np.eye(k, n))


def test_code_of_large_arrays_is_as_long_as_that_of_small_ones():
    def f(x):
        y = jnp.sort(jnp.sin(x) @ jnp.cos(x))
        return (
            jnp.cumsum(y[::-1]),
            lax.fori_loop(0, 9, lambda i, c: c.at[i % 7].add(c[-1]), x),
            y.at[y.argmax()].set(0.0),
        )

    lines = [lower(jax.make_jaxpr(f)(np.ones((n, n))), 16).count("\n") for n in (16, 64, 256)]
    assert max(lines) < 1.5 * min(lines)


def test_calls_that_use_their_operands_twice_do_not_double_the_code():
    def f(x):
        for _ in range(25):
            x = jax.jit(lambda x: jnp.tanh(x) * x[::-1] + x)(x)
        return x

    assert lower(jax.make_jaxpr(f)(np.ones(50)), 1).count("\n") < 2000


@pytest.mark.slow
def test_long_chains_are_cut():
    def f(x):
        for _ in range(1500):
            x = jnp.sin(x)
        return x

    assert not differences(f, np.linspace(0, 1, 30), plan=Options(1, 0))


@pytest.mark.slow
def test_many_arrays_do_not_overflow_the_stack():
    def f(x):
        found = []
        for i in range(700):
            x = jnp.sin(x) + i
            found.append(x)
        return sum(y[::-1] for y in found)

    x = np.linspace(0, 1, 2000)
    assert not differences(f, x, plan=Options(1, 0))


# --- bounds ----------------------------------------------------------------------------------------------------------


def _child(function):
    """Run in a process of its own, since a failed check aborts; -> its exit status."""
    code = f"import sys; sys.path[:0] = {sys.path!r}\n"
    code += f"import jax; jax.config.update('jax_enable_x64', True)\nimport test_emission; test_emission.{function}()"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)


def run_checked_programs():
    """Programs that keep within bounds."""
    for case, (_, operands) in ARRAYS.items():
        for small in (1, 16):
            Compiled(_trace(case), plan=Options(small, 0), checked=True)(*jax.tree.leaves(operands))
    for seed in range(60):
        program, operands = random_program(functools.partial(random.Random(seed).randrange))
        Compiled(program, plan=Options((1, 8)[seed % 2], 0), checked=True)(*operands)


def test_a_branch_that_changes_nothing_copies_nothing():
    """Of three copies one brings the input, one the new value, and one the output."""

    def function(x):
        def turn(i, c):
            return jax.lax.cond(i % 7 == 0, lambda c: c[::-1] * 0.5, lambda c: c, c)

        return jax.lax.fori_loop(0, 50, turn, x)

    x = np.arange(100.0)
    compiled = native.compile(function, x)
    assert compiled.compiled.text.count("i64 800, i1 false") == 3
    np.testing.assert_array_equal(compiled(x), jax.jit(function)(x))


def test_arrays_that_come_together_are_worked_out_in_one_loop():
    """Results of a branch, which stay where it has put them, and the parts of a stack."""

    def branches(flag, x):
        return lax.cond(flag, lambda: (x + 1, 2 * x), lambda: (x, x))

    def emitted(function, *example):
        text = lower(jax.make_jaxpr(function)(*example), 4)
        return text.count(" phi i64 "), text.count("call void @llvm.memcpy")

    x = jnp.arange(100.0)
    assert emitted(branches, True, x) == (
        1,
        4,
    )  # copies: of x by the branch that changes nothing, and out of the program
    assert emitted(lambda x: jnp.stack([x + 1, 2 * x, x - 1]), x) == (1, 1)
    for flag in (True, False):
        for found, wanted in zip(native.compile(branches, flag, x)(flag, x), branches(flag, x), strict=True):
            assert np.array_equal(found, wanted)


def run_wrong_program():
    """A program that reads the fifth of four elements."""
    b = Emitter(checked=True)
    b.line("%index = load i64, ptr %inputs, align 8")
    b.check_index("%index", 4)
    text = ["define void @call(ptr %inputs, ptr %outputs) {", "entry:", *b.lines, "  ret void", "}"]
    linked = Linked(object_code("\n".join([*sorted(b.declarations), *text]), 2), ["call"], {})
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(linked.address("call"))
    for index in (0, 3, 4):
        print("index", index, flush=True)
        call(ctypes.byref(ctypes.c_int64(index)), None)
    print("not stopped")


@pytest.mark.slow
def test_programs_keep_within_their_arrays():
    child = _child("run_checked_programs")
    assert child.returncode == 0, child.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="abort() has another exit status")
def test_access_out_of_bounds_is_stopped():
    child = _child("run_wrong_program")
    assert child.returncode < 0
    assert child.stdout.split() == ["index", "0", "index", "3", "index", "4"]


def test_known_indices_out_of_bounds_are_errors():
    with pytest.raises(IndexError, match="index 4 of an array of 4"):
        Emitter(checked=True).check_index(4, 4)


def test_a_text_that_is_wrong_is_not_compiled():
    with pytest.raises(RuntimeError, match="parsing error"):
        object_code("define void @call(ptr %inputs, ptr %outputs) { entry: ret i32 0 }", 1)


# --- many cells ------------------------------------------------------------------------------------------------------


def lorenz_96(n, columns):
    """RK4 steps of n coupled cells and of so many tangents of them, orthonormalised."""

    def field(x):
        return (jnp.roll(x, -1) - jnp.roll(x, 2)) * jnp.roll(x, 1) - x + 8.0

    def step(x):
        k1 = field(x)
        k2 = field(x + 0.005 * k1)
        k3 = field(x + 0.005 * k2)
        return x + 0.01 / 6 * (k1 + 2 * (k2 + k3) + field(x + 0.01 * k3))

    def body(carry, _):
        x, frame = carry
        x, push = jax.linearize(step, x)
        frame, r = jnp.linalg.qr(jax.vmap(push, in_axes=1, out_axes=1)(frame))
        return (x, frame), jnp.log(jnp.abs(jnp.diagonal(r)))

    return lambda x, frame: jax.lax.scan(body, (x, frame), length=10), jnp.zeros(n).at[0].set(1.0), jnp.eye(n, columns)


@pytest.mark.parametrize("n", [40, 1000])
def test_many_cells_make_little_code(n):
    function, *operands = lorenz_96(n, 4 if n == 1000 else n)
    compiled = native.Compiled(jax.make_jaxpr(function)(*operands))
    assert len(compiled.text.splitlines()) < 6000
    if n == 40:
        found, wanted = compiled(*operands), jax.tree.leaves(jax.jit(function)(*operands))
        for ours, theirs in zip(found, wanted, strict=True):
            np.testing.assert_allclose(np.abs(ours), np.abs(theirs), rtol=1e-7, atol=1e-9)


@pytest.mark.slow_cases("<lambda>-True2")
@pytest.mark.parametrize(
    ("function", "long"),
    [
        (lambda x: jnp.sin(x) @ x, False),
        (lambda x: lax.fori_loop(0, 10, lambda i, x: x * 0.5, x), False),
        (lambda x: lax.fori_loop(0, 5000, lambda i, x: x * 0.5, x), True),
        (jax.jit(lambda x: lax.while_loop(lambda x: x[0] < 1, lambda x: x + 0.1, x)), True),
        (lambda x: native.native(lambda x: lax.while_loop(lambda x: x[0] < 1, lambda x: x + 0.1, x))(2 * x), True),
    ],
)
def test_what_is_run_through_once_is_compiled_soon(function, long):
    assert runs_long(jax.make_jaxpr(function)(jnp.ones(3)).jaxpr) == long
