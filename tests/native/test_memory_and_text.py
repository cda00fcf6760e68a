"""The parts that lowering is made of, each alone: expressions, indices, memory, lanes; their code is run."""

import ctypes
import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from against_xla import differences
from lyaphybrid.native.lowering import emitter, values
from lyaphybrid.native.lowering.costs import Options
from lyaphybrid.native.lowering.emitter import Emitter
from lyaphybrid.native.lowering.lowering import lower
from lyaphybrid.native.lowering.unsupported import UnsupportedError
from lyaphybrid.native.lowering.values import Buffer, MemoryBlock, Values
from lyaphybrid.native.machine.code import Linked
from lyaphybrid.native.machine.emission import object_code


def run(b: Emitter, inputs, results) -> None:
    """Run the code, in which %inputs and %outputs are arrays of numbers."""
    text = [*b.constants, *sorted(b.declarations), "define void @call(ptr %inputs, ptr %outputs) {", "entry:"]
    text += [*b.allocations, *b.lines, *b.releases, "  ret void", "}"]
    linked = Linked(object_code("\n".join(text), 1), ["call"], {})
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(linked.address("call"))
    call(inputs.ctypes.data, results.ctypes.data)


# --- expressions -----------------------------------------------------------------------------------------------------


def test_what_is_known_and_what_is_the_same():
    assert emitter.is_known(1, 2.0, True)
    assert not emitter.is_known(1, "%s1")
    assert not emitter.is_known("%s1", 1)
    assert emitter.is_wide("%w1")
    assert not emitter.is_wide("%s1")
    assert not emitter.is_wide(1.0)
    different = [0.0, -0.0, 1, 1.0, True, False, 0, "%s1", "%s2", "1"]
    for i, a in enumerate(different):
        for j, other in enumerate(different):
            assert emitter.same(a, other) == (i == j)


def test_an_expression_is_written_once_in_its_scope():
    b = Emitter()
    first = b.binary("fadd", "double", "%s100", "%s101", commutes=True)
    assert b.binary("fadd", "double", "%s101", "%s100", commutes=True) == first
    assert b.binary("fsub", "double", "%s100", "%s101") != b.binary("fsub", "double", "%s101", "%s100")
    assert len(b.lines) == 3
    scope = b.scope()
    inside = b.binary("fmul", "double", "%s100", "%s101")
    assert b.binary("fmul", "double", "%s100", "%s101") == inside
    b.end_scope(scope)
    assert b.binary("fmul", "double", "%s100", "%s101") != inside
    assert b.binary("fadd", "double", "%s100", "%s101", commutes=True) == first
    each = [b.binary("fadd", "double", "%s100", number) for number in (0.0, -0.0, 1.0, 2.0)]
    assert len(set(each)) == 4
    assert b.binary("icmp eq", "i64", "%s1", 1) != b.binary("icmp eq", "i64", "%s1", True)


def test_calls_are_written_once_and_declared():
    b = Emitter(2)
    assert b.call("sinh", "double", ["%s100"]) == b.call("sinh", "double", ["%s100"])
    wide = b.call("sinh", "double", ["%w101"])
    assert emitter.is_wide(wide)
    assert b.call("sinh", "double", ["%w101"]) == wide
    assert "\n".join(b.lines).count("call double @sinh(") == 3  # one and two
    assert b.intrinsic("llvm.sqrt", "double", ["%w101"]) == b.intrinsic("llvm.sqrt", "double", ["%w101"])
    assert sum("@llvm.sqrt.v2f64(<2 x double>" in line for line in b.lines) == 1
    assert len(b.declarations) == 2


@pytest.mark.parametrize("width", [2, 4])
def test_vectors_of_entries(width):
    """Elements that are known, unknown and left out; spread, taken apart, and put together."""
    b = Emitter(width)
    x, y = (b.load("%inputs", "double", i) for i in (0, 1))
    whole = b.load("%inputs", "double", 0, wide=True)
    found = [
        b.vector([x, 2.0], "double"),
        b.vector([3.0, 4.0], "double"),
        b.binary("fmul", "double", whole, y),
        b.binary("fadd", "double", 1.0, whole),
        b.vector([b.element(whole, 1, "double"), b.element(x, 1, "double")], "double"),
    ]
    assert all(map(emitter.is_wide, found))
    assert b.vector([x, x], "double") == x
    assert b.vector([5.0, 5.0], "double") == 5.0
    count = len(b.lines)
    assert b.vector([x, 2.0], "double") == found[0]
    assert b.element(whole, 1, "double") == b.element(whole, 1, "double")
    assert b.spread(y, "double") == b.spread(y, "double")
    assert len(b.lines) == count
    for i, vector in enumerate(found):
        b.store("%outputs", "double", i * width, vector, wide=True)
    inputs, results = np.arange(1.0, width + 1) ** 2, np.zeros(len(found) * width)
    run(b, inputs, results)
    rows = results.reshape(-1, width)
    assert_array_equal(rows[:2, :2], [[1, 2], [3, 4]])
    assert_array_equal(rows[2:4], [inputs * 4, inputs + 1])
    assert_array_equal(rows[4, :2], [4, 1])


@pytest.mark.parametrize("type_", ["i1", "i64"])
def test_selections(type_):
    """Of what is known or not; conditions by `and` and `or`, where one side is known."""
    b = Emitter()
    condition, x, y = b.load("%inputs", "i1", 0), b.load("%inputs", type_, 1), b.load("%inputs", type_, 2)
    assert (b.select(True, type_, x, y), b.select(False, type_, x, y), b.select(condition, type_, x, x)) == (x, y, x)
    each = [(p, q) for p in (x, True, False) for q in (y, True, False)]
    for place, (p, q) in enumerate(each):
        b.store("%outputs", type_, place, b.select(condition, type_, p, q))
    assert b.select(condition, type_, x, y) == b.select(condition, type_, x, y)
    text = "\n".join(b.lines)
    assert (" and i1" in text, " or i1" in text) == (type_ == "i1",) * 2
    of = np.int8 if type_ == "i1" else np.int64
    for inputs in itertools.product((0, 1), repeat=3):
        results = np.zeros(9, of)
        run(
            b,
            np.frombuffer(
                np.array(inputs[:1], np.int8).tobytes() + bytes(of().itemsize - 1) + np.array(inputs[1:], of).tobytes(),
                of,
            ),
            results,
        )
        values_of = {x: inputs[1], y: inputs[2]}
        assert results.tolist() == [int(values_of.get(p if inputs[0] else q, p if inputs[0] else q)) for p, q in each]


# --- indices and loops -----------------------------------------------------------------------------------------------


def test_indices_in_row_major_order():
    b = Emitter()
    assert b.linear_index([1, 2, 3], [5, 6, 7]) == (1 * 6 + 2) * 7 + 3
    assert (b.index_times("%s1", 0), b.index_times("%s1", 1), b.index_times(3, 4)) == (0, "%s1", 12)
    assert (b.index_sum(0, "%s1"), b.index_sum("%s1", 0), b.index_sum(2, 3)) == ("%s1", "%s1", 5)
    assert not b.lines
    i, j = (b.load("%inputs", "i64", place) for place in (0, 1))
    places = ([i, j], [4, 5]), ([i, 2], [4, 5]), ([3, j], [4, 5]), ([i, 0, j], [4, 2, 5])
    for place, (indices, shape) in enumerate(places):
        b.store("%outputs", "i64", place, b.linear_index(indices, shape))
    results = np.zeros(4, np.int64)
    run(b, np.array([2, 4]), results)
    assert_array_equal(results, [2 * 5 + 4, 2 * 5 + 2, 3 * 5 + 4, (2 * 2 + 0) * 5 + 4])


def test_nested_loops_carry_values():
    """The sum of i · 10 + j, and its terms in their places; lengths of one need no loop, of zero no code."""
    b = Emitter()

    def body(indices, carried):
        number = b.index_sum(b.index_times(indices[0], 10), indices[2])
        b.store("%outputs", "i64", b.index_sum(b.linear_index(indices, (3, 1, 4)), 1), number)
        return [b.index_sum(carried[0], number)]

    (total,) = b.fold_indices((3, 1, 4), body, [(0, "i64")])
    b.store("%outputs", "i64", 0, total)
    assert "\n".join(b.lines).count(" = phi i64 ") == 4
    results = np.zeros(13, np.int64)
    run(b, results, results)
    terms = [10 * i + j for i in range(3) for j in range(4)]
    assert_array_equal(results, [sum(terms), *terms])
    count = len(b.lines)
    b.for_each_index((3, 0), lambda i: pytest.fail("nothing to do"))
    assert len(b.lines) == count


# --- memory ----------------------------------------------------------------------------------------------------------


def test_memory_on_the_stack_and_elsewhere():
    """Up to 16384 bytes, 2^18 in all, on the stack; all of it begins at a cache line; what is not there is freed."""
    b = Emitter()
    pointers = [b.allocate("double", 2048), b.allocate("double", 2049), b.allocate("i8", 3)]
    pointers += [b.allocate("double", 2048) for _ in range(15)]  # 3 bytes too many
    assert sum("alloca" in line for line in b.allocations) == 16
    assert len(b.releases) == sum("@malloc(" in line for line in b.allocations) == 2
    assert f"@malloc(i64 {2049 * 8 + 64})" in "".join(b.allocations)
    pointers.append(b.allocate("i8", 2**18 - 15 * 16384 - 3))  # there is just room for this one
    assert len(b.releases) == 2
    pointers.append(b.allocate("i8", 1))
    assert len(b.releases) == 3
    for i, pointer in enumerate(pointers):
        name = b.name()
        b.line(f"{name} = ptrtoint ptr {pointer} to i64")
        b.store("%outputs", "i64", i, name)
    results = np.zeros(len(pointers), np.int64)
    run(b, results, results)
    assert np.all(results % 64 == 0)
    assert len(set(results)) == len(pointers)


@pytest.mark.parametrize("wide", [False, True])
def test_booleans_are_bytes(wide):
    b = Emitter(2)
    b.store("%outputs", "i1", 0, b.negation(b.load("%inputs", "i1", 0, wide)), wide)
    results = np.full(3, 9, np.int8)
    run(b, np.array([7, 0, 1], np.int8), results)  # what is not zero is true
    assert_array_equal(results, [0, 1, 9] if wide else [0, 9, 9])


def test_what_may_be_overwritten():
    block = MemoryBlock("%p", 3, True)
    assert block.is_free()
    block.holders = 1
    assert not block.is_free()
    assert not MemoryBlock("%p", 3, False).is_free()
    b = Values(4)
    own = b.new_buffer((6,), np.dtype(float))
    assert own.memory.writable
    assert b.to_write(own, own.dtype) is own
    assert b.to_write(own, own.dtype, [own]) is not own  # it is read while it is written
    own.memory.holders = 1
    assert b.to_write(own, own.dtype) is not own
    constant = values.filled((2,), [1.0, 2.0])
    assert b.to_write(constant, np.dtype(float)).memory.writable
    assert not b.in_memory(constant, np.dtype(float)).memory.writable


def test_arrays_that_read_what_is_overwritten_are_worked_out_before():
    b = Values(4)
    own = b.new_buffer((6,), np.dtype(float))
    scope = b.scope()
    b.lazy((6,), np.dtype(float), lambda i: b.load_element(own, i), [own])
    kept = b.lazy((6,), np.dtype(float), lambda i: b.load_element(own, i), [own])
    assert kept in own.memory.readers
    assert b.to_write(own, own.dtype) is own
    assert kept.buffer is not None
    assert kept.buffer.memory.writable
    later = b.lazy((6,), np.dtype(float), lambda i: b.load_element(own, i), [own])
    b.end_scope(scope)
    assert later not in own.memory.readers


def test_what_two_loops_need_is_computed_once():
    """Unless it is only read: then it needs no memory."""

    def text(function):
        return lower(jax.make_jaxpr(function)(np.ones(50)), 16)

    assert text(lambda x: (lambda y: (y * 2, y[::-1]))(jnp.tanh(x))).count("call double @tanh(") == 1
    assert text(lambda x: (lambda y: (y * 2, y[::-1]))(jnp.concatenate([x[:20], x[20:]]))).count("alloca") <= 1
    assert text(lambda x: (lambda y: (y * 2, y.sum()))(x[::-1])).count("alloca") == 0


def test_entries_that_a_loop_reads_lie_in_memory():
    """Not chosen from by comparisons, each time."""
    for n in (2, 8):
        program = jax.make_jaxpr(lambda x, y: x[:, None] * y)(np.ones(n), np.ones((n, 50)))
        assert " select " not in lower(program, 16)


def test_few_numbers_are_put_into_an_array_from_registers():
    """One after the other; many are put by a loop."""

    def text(n):
        return lower(jax.make_jaxpr(lambda x, at, y: x.at[at].add(y * 2))(np.ones(50), np.arange(n), np.ones(n)), 16)

    assert (" phi " in text(3), " phi " in text(30)) == (False, True)


def test_a_slice_is_written_into_registers_or_into_memory():
    """Where its place is known at run time only: few numbers are chosen one by one, many are not."""

    def text(n):
        put = lambda x, i: jax.lax.dynamic_update_slice(x * 2, x[:2], (i,))  # noqa: E731
        return lower(jax.make_jaxpr(put)(np.ones(n), 1), 16)

    assert "alloca" not in text(4)
    assert text(4).count(" select ") > 4 > text(50).count(" select ")


def test_up_to_sixteen_numbers_are_sorted_in_registers():
    def text(n):
        return lower(jax.make_jaxpr(lambda x: jnp.sort(x * 1.5))(np.ones(n)), 64)

    assert ("alloca" in text(16), "alloca" in text(17)) == (False, True)


def test_axes_of_length_one_need_no_memory():
    text = lower(jax.make_jaxpr(lambda x: jnp.tanh(x).reshape(50, 1) * 2.0)(np.ones(50)), 16)
    assert "alloca" not in text


def test_long_arrays_of_counted_numbers_are_not_kept():
    text = lower(jax.make_jaxpr(lambda x: x + jnp.arange(50.0))(np.ones(50)), 16)
    assert " constant " not in text


def test_numbers_without_a_type_here_are_refused():
    program = jax.make_jaxpr(lambda x: x * jnp.real(jnp.asarray([1 + 2j, 3.0])))(np.ones(2))
    with pytest.raises(UnsupportedError, match="complex128"):
        lower(program, 16)


def test_arrays_in_a_loop_are_at_most_sixteen():
    groups = values._alike([*range(40), *range(100, 103)], lambda i: i >= 100)
    assert [len(group) for group in groups] == [16, 16, 8, 3]


# --- frames and lanes ------------------------------------------------------------------------------------------------


def test_which_arrays_are_frames():
    number, integer = np.dtype(float), np.dtype(np.int64)
    assert values.rows_available((5, 2), number, 2)
    shapes = (((5, 1), number, 1), ((5, 3), number, 2), ((5,), number, 5), ((5, 2), integer, 2), ((1, 5, 2), number, 2))
    assert not any(values.rows_available(*one) for one in shapes)
    program = jax.make_jaxpr(lambda x: jax.lax.fori_loop(0, 9, lambda i, x: x * x, x))(np.ones((5, 2)))
    assert lower(program, 16, columns=2).count("fmul <2 x double>") == 5
    assert "x double>" not in lower(program, 9, columns=2)
    product = jax.make_jaxpr(lambda a, x: jax.lax.fori_loop(0, 9, lambda i, x: a @ x, x))(np.eye(5), np.ones((5, 2)))
    assert not re.search(r"f(add|mul) double", lower(product, 32, columns=2))


def test_rows_go_through_calls_and_loops_as_they_are():
    def turn(i, x):
        return jax.lax.fori_loop(0, 3, lambda j, y: jax.jit(jnp.square)(y), jax.lax.optimization_barrier(x))

    text = lower(jax.make_jaxpr(lambda x: jax.lax.fori_loop(0, 9, turn, x))(np.ones((5, 2))), 16, columns=2)
    assert text.count("extractelement") == 10  # at the end


def test_rows_become_entries_where_a_rule_has_none():
    def function(frame):
        def body(_, c):
            return jnp.cumsum(jnp.sort(c * 1.5, axis=0), axis=1) - c.argmax(axis=0).astype(float)[None] * c

        return jax.lax.fori_loop(0, 3, body, frame)

    frame = np.array([[0.5, -1.0, 2.0], [1.0, 0.25, -3.0]])
    assert "fmul <4 x double>" in lower(jax.make_jaxpr(function)(frame), 32, columns=3)
    assert not differences(function, frame, columns=3, plan=Options(32, 1))


@pytest.mark.parametrize("axis", [0, 1])
def test_rows_are_taken_apart_along_their_axes(axis):
    """`split` and `unstack` of a frame: along the first axis rows stay vectors, along the last they become entries."""

    def function(frame):
        def body(_, c):
            first, second = jnp.split(c * 1.5, [1], axis=axis)
            a, b, *_ = jnp.unstack(jnp.concatenate([second, first], axis=axis), axis=axis)
            return c + 0.1 * jnp.stack([a - b, b, a], axis=axis)

        return jax.lax.fori_loop(0, 3, body, frame)

    frame = np.array([[0.5, -1.0, 2.0], [1.0, 0.25, -3.0], [0.1, 0.7, 0.3]])
    assert not differences(function, frame, columns=3, plan=Options(32, 1))


MASK = [True, False, True, True]


@pytest.mark.parametrize("shared", [False, True], ids=["of lanes", "shared"])
@pytest.mark.parametrize("blended", [False, True])
def test_a_copy_leaves_lanes_that_do_not_take_part(shared, blended):
    """%inputs: a number for each lane, or one for all; %outputs: for each lane."""
    b = Values(1, lanes=4)
    source = Buffer(MemoryBlock("%inputs", 3, False, not shared), (3,), np.dtype(float))
    to = Buffer(MemoryBlock("%outputs", 3, True, True), (3,), np.dtype(float))
    if blended:
        b.mask = b.vector(MASK, "i1")
    b.copy_buffer(to, source)
    assert ("memcpy" in "".join(b.lines)) == (not shared and not blended)
    inputs, results = np.arange(1.0, 4.0 if shared else 13.0), -np.arange(1.0, 13.0)
    wanted = np.repeat(inputs, 4) if shared else inputs
    wanted = np.where(np.tile(MASK, 3), wanted, results) if blended else wanted
    run(b, inputs, results)
    assert_array_equal(results, wanted)


def test_a_copy_into_memory_of_the_same_lanes_is_plain():
    """What was allocated where only these lanes are active has nothing of the others."""
    b = Values(1, lanes=4)
    b.mask = "%w1"
    to, other = b.new_buffer((3,), np.dtype(float)), b.new_buffer((3,), np.dtype(float))
    b.copy_buffer(to, other)
    assert len(b.lines) == 1
    assert "i64 96, i1 false" in b.lines[0]


@pytest.mark.parametrize("shared", [False, True], ids=["of lanes", "shared"])
def test_each_lane_has_its_own_index(shared):
    b = Values(1, lanes=2)
    array = Buffer(MemoryBlock("%inputs", 3, False, not shared), (3,), np.dtype(float))
    index = b.vector([2, 1], "i64")
    b.store("%outputs", "double", 0, b.load_element(array, [index]), wide=True)
    results = np.zeros(2)
    inputs = np.arange(3.0) if shared else np.arange(6.0)  # element i of lane j: 2 i + j
    run(b, inputs, results)
    assert_array_equal(results, [2, 1] if shared else [4, 3])
    b = Values(1, lanes=2)
    array = Buffer(MemoryBlock("%outputs", 3, True, True), (3,), np.dtype(float))
    b.store_element(array, [b.vector([2, 1], "i64")], b.load("%inputs", "double", 0, wide=True))
    results = np.zeros(6)
    run(b, np.array([7.0, 8.0]), results)
    assert_array_equal(results, [0, 0, 0, 8, 7, 0])
    assert "abort" not in "".join(b.lines)  # indices are checked only where that is wanted


def test_memory_of_lanes():
    assert Values(1, lanes=2).new_buffer((3,), np.dtype(float)).memory.wide
    assert not Values(1).new_buffer((3,), np.dtype(float)).memory.wide
    assert Values(1, lanes=2).carries_vectors
