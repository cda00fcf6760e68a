"""What is written for LLVM: for other machines, in bounded size, and with checks that bite."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest

from lyaphybrid import native
from lyaphybrid.native._compiled import object_code
from lyaphybrid.native._lowering import lower

llvm.initialize_all_targets()
llvm.initialize_all_asmprinters()


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


@pytest.mark.parametrize("triple", ["aarch64-unknown-linux-gnu", "arm64-apple-macosx", "x86_64-pc-windows-msvc"])
def test_code_for_other_machines(triple):
    function, *operands = lorenz_96(5, 3)
    text = native.Compiled(jax.make_jaxpr(function)(*operands), columns=3).text
    machine = llvm.Target.from_triple(triple).create_target_machine(opt=2, reloc="pic")
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = triple, str(machine.target_data)
    module.verify()
    assert len(machine.emit_object(module)) > 1000


@pytest.mark.parametrize("n", [40, 1000])
def test_many_cells_make_little_code(n):
    function, *operands = lorenz_96(n, 4 if n == 1000 else n)
    compiled = native.Compiled(jax.make_jaxpr(function)(*operands))
    assert len(compiled.text.splitlines()) < 6000
    if n == 40:
        found, wanted = compiled(*operands), jax.tree.leaves(jax.jit(function)(*operands))
        for ours, theirs in zip(found, wanted, strict=True):
            np.testing.assert_allclose(np.abs(ours), np.abs(theirs), rtol=1e-7, atol=1e-9)


def test_the_same_program_is_written_the_same_way():
    function, *operands = lorenz_96(7, 3)
    closed = jax.make_jaxpr(function)(*operands)
    assert lower(closed, 16, columns=3) == lower(closed, 16, columns=3)


CHECK = """
import jax, jax.numpy as jnp, sys
from lyaphybrid import native
from lyaphybrid.native import _values
def beyond(self, buffer, indices):
    return read(self, buffer, [self.index_sum(indices[0], int(sys.argv[1])), *indices[1:]])
read, _values.Values.load_element = _values.Values.load_element, beyond
x = jnp.arange(100.0, dtype=jnp.float32)
print(native.compile(lambda x: jnp.cumsum(x), x, checked=True)(x)[50])
"""


@pytest.mark.parametrize(("shift", "fails"), [(0, False), (-1, True)])
def test_an_index_out_of_bounds_stops_a_checked_program(shift, fails):
    done = subprocess.run(
        [sys.executable, "-c", CHECK, str(shift)], env=os.environ | {"LYAPHYBRID_CACHE": "off"}, capture_output=True
    )
    assert (done.returncode != 0) == fails
    assert (b"1275.0" in done.stdout) != fails


def test_a_text_that_is_wrong_is_not_compiled():
    with pytest.raises(RuntimeError, match="parsing error"):
        object_code("define void @call(ptr %inputs, ptr %outputs) { entry: ret i32 0 }", 1)
