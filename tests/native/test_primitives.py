"""Each primitive that has a rule against XLA: over types, shapes, edge values, in registers and in memory."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options

# Arrays up to the size are held as entries, larger ones in memory.
PLANS = {"in memory": Options(1, 1), "mixed": Options(8, 1), "entries": Options(64, 0)}
FLOATS = np.array([0.0, -0.0, 1.0, -1.5, 0.3, 2.5, -7.25, 1e10, -1e-10, np.inf, -np.inf, np.nan])
INTEGERS = [0, 1, -1, 2, 7, -13, 100, 31, 32, 64, 127, -128]


@functools.cache
def by_xla(functions):
    """What XLA compiles functions to: once for all plans, as long as the functions are the same ones."""
    return jax.jit(several(*functions))


def check(functions, *operands, plan, rtol=1e-13, **options):
    """The same shapes, types and numbers as XLA's; integers and conditions exactly."""
    found = native.compile(several(*functions), *operands, plan=plan, **options)(*operands)
    compare(found, by_xla(tuple(functions))(*operands), rtol)


def compare(found, wanted, rtol=1e-13):
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for place, (ours, theirs) in enumerate(zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True)):
        assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype), place
        if np.issubdtype(ours.dtype, np.floating):
            tolerance = rtol if ours.dtype == np.float64 else 2e-6
            np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance, err_msg=f"result {place}")
        else:
            np.testing.assert_array_equal(ours, theirs, err_msg=f"result {place}")


def several(*functions):
    """One program of many, so that there is one compilation."""
    return lambda *operands: [function(*operands) for function in functions]


@pytest.fixture(params=PLANS, ids=lambda name: name.replace(" ", "-"))
def plan(request):
    return PLANS[request.param]


# --- entry by entry --------------------------------------------------------------------------------------------------

OF_TWO_NUMBERS = [
    lax.add, lax.sub, lax.mul, lax.div, lax.rem, lax.max, lax.min, lax.eq, lax.ne, lax.lt, lax.le, lax.gt, lax.ge,
]  # fmt: skip
OF_TWO_INTEGERS = [
    lax.bitwise_and, lax.bitwise_or, lax.bitwise_xor, lax.shift_left, lax.shift_right_logical,
    lax.shift_right_arithmetic,
]  # fmt: skip
OF_A_FLOAT = [
    lax.neg, lax.abs, lax.sign, lax.floor, lax.ceil, lax.is_finite, lax.square, jnp.positive, lax.sqrt, lax.rsqrt,
    lambda x: lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN),
    lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO),
    lambda x: lax.integer_pow(x, 3), lambda x: lax.integer_pow(x, -2), lambda x: lax.integer_pow(x, 0),
    lambda x: x.astype(jnp.int32), lambda x: x.astype(jnp.int64), lambda x: x.astype(bool),
    lambda x: x.astype(jnp.float32), lambda x: x.astype(jnp.float64),
    lambda x: lax.clamp(jnp.asarray(-1, x.dtype), x, jnp.asarray(5, x.dtype)),
]  # fmt: skip
OF_AN_INTEGER = [
    lax.bitwise_not, lax.neg, lax.sign, lax.abs, lax.population_count, lax.clz,
    *(lambda x, to=to: x.astype(to) for to in ("int8", "int32", "int64", "uint8", "uint32", "float64", "bool")),
]  # fmt: skip
TO_INTEGERS = [lambda x, to=to: x.astype(to) for to in ("int8", "int32", "int64", "uint8", "uint32", "uint64")]
OF_TWO_CONDITIONS = [
    lax.bitwise_and, lax.bitwise_or, lax.bitwise_xor, lax.eq, lax.ne, lax.lt, lax.ge, lax.max, lax.min,
    lambda a, b: ~a, lambda a, b: jnp.where(a, b, ~b),
]  # fmt: skip
SELECTION = [lambda which, x: lax.select_n(which, x, 2 * x, 3 * x)]
AS_INTEGER, AS_FLOAT = ([lambda x, to=to: lax.bitcast_convert_type(x, to)] for to in (jnp.int64, jnp.float32))
SMOOTH = [
    lax.sin, lax.cos, lax.tan, lax.exp, lax.exp2, lax.expm1, lax.logistic, lax.tanh, lax.sinh, lax.cosh, lax.atan,
    lax.asinh, lax.erf, lax.erfc, lax.cbrt, lambda x: lax.log(lax.abs(x)), lambda x: lax.log1p(lax.abs(x)),
    lambda x: lax.pow(lax.abs(x), x), lambda x: lax.atan2(x, x[::-1]), lambda x: lax.asin(lax.sin(x)),
    lambda x: lax.acos(lax.cos(x)), lambda x: lax.acosh(1 + lax.abs(x)), lambda x: lax.atanh(lax.tanh(x / 4)),
    lambda x: lax.lgamma(1 + lax.abs(x)), lambda x: lax.nextafter(x, x + 1),
]  # fmt: skip
# XLA's own approximations are good to a few units in the last place: ours come from the C library.


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_arithmetic_of_floats(dtype, plan):
    x, y = (part.ravel().astype(dtype) for part in np.meshgrid(FLOATS, FLOATS))
    check(OF_TWO_NUMBERS, jnp.asarray(x), jnp.asarray(y), plan=plan)
    check(OF_A_FLOAT, jnp.asarray(FLOATS.astype(dtype)), plan=plan)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_elementary_functions(dtype, plan):
    check(SMOOTH, jnp.linspace(-6.5, 7.0, 12, dtype=dtype), plan=plan, rtol=1e-13)


@pytest.mark.parametrize("dtype", ["int8", "int32", "int64", "uint8", "uint32", "uint64"])
def test_arithmetic_of_integers(dtype, plan):
    limits = np.iinfo(dtype)
    numbers = np.array([*[n % (int(limits.max) + 1) if n < 0 and limits.min == 0 else n for n in INTEGERS]], object)
    numbers = np.array([*np.clip(numbers, limits.min, limits.max), limits.min, limits.max, limits.max - 1], dtype)
    x, y = (jnp.asarray(part.ravel()) for part in np.meshgrid(numbers, numbers))
    check([*OF_TWO_NUMBERS, *OF_TWO_INTEGERS], x, y, plan=plan)
    check([*OF_AN_INTEGER[: 4 if limits.min else 3], *OF_AN_INTEGER[4:]], jnp.asarray(numbers), plan=plan)


def test_floats_beyond_the_range_of_integers(plan):
    numbers = jnp.asarray(
        [1e300, -1e300, np.nan, np.inf, -np.inf, 2.0**63, -(2.0**63), 2.0**31, -(2.0**31) - 1, 255.9, -0.9]
    )
    check(TO_INTEGERS, numbers, plan=plan)


def test_conditions(plan):
    a, b = jnp.asarray([True, True, False, False]), jnp.asarray([True, False, True, False])
    check(OF_TWO_CONDITIONS, a, b, plan=plan)
    which = jnp.asarray([0, 2, 1, 2], jnp.int32)
    check(SELECTION, which, jnp.arange(4.0), plan=plan)


def test_bits_seen_as_another_type(plan):
    check(AS_INTEGER, jnp.asarray(FLOATS[:-1]), plan=plan)
    check(AS_FLOAT, jnp.arange(12, dtype=jnp.int32) * 12345678, plan=plan)


def test_denormals_are_kept(plan):
    """XLA sets them to zero; NumPy does not."""
    tiny = np.array([5e-324, 1e-310, -2e-308 / 3, 0.0])
    (found,) = native.compile(lambda x: [x * 3], tiny, plan=plan)(tiny)
    np.testing.assert_array_equal(found, tiny * 3)


# --- moving entries --------------------------------------------------------------------------------------------------

MATRIX = jnp.asarray(np.random.default_rng(0).normal(size=(4, 6)))
LARGE = jnp.asarray(np.random.default_rng(1).normal(size=(9, 14)))
MOVES = [
    lambda x: x.T,
    lambda x: x.reshape(2, -1),
    lambda x: x[1:, ::2],
    lambda x: x[::-1, 1],
    lambda x: jnp.flip(x),
    lambda x: jnp.expand_dims(x, (0, 2)),
    lambda x: jnp.squeeze(x[:, None, :1]),
    lambda x: jnp.broadcast_to(x[:, None], (x.shape[0], 3, x.shape[1])),
    lambda x: jnp.concatenate([x, 2 * x[:1], x[1:] + 1], axis=0),
    lambda x: jnp.concatenate([x, x[:, :2]], axis=1),
    lambda x: jnp.stack([x, -x, x + 1], axis=1),
    lambda x: lax.pad(x, 7.0, [(1, 2, 0), (0, 1, 2)]),
    lambda x: lax.pad(x, -1.0, [(-1, 2, 1), (2, -3, 0)]),
    lambda x: jnp.split(x, 2, axis=1),
    lambda x: list(x),
    lambda x: jnp.arange(x.size).reshape(x.shape) + lax.broadcasted_iota(jnp.int64, x.shape, 1),
    lambda x: jnp.tile(x, (2, 1)),
    lambda x: jnp.roll(x, 2, axis=1),
    lambda x: jnp.exp(x)[:, None, :] * jnp.sin(x)[None, :, :],  # each entry is used many times
    lambda x: jnp.zeros((0, 3)) + x[:0, :3],
]


@pytest.mark.parametrize("matrix", [MATRIX, LARGE], ids=["small", "large"])
def test_moving(matrix, plan):
    check(MOVES, matrix, plan=plan)


# --- reductions and products -----------------------------------------------------------------------------------------

REDUCTIONS = [
    *(lambda x, f=f, axis=a: f(x, axis=axis) for f in (jnp.sum, jnp.prod, jnp.max, jnp.min) for a in (0, 1, None)),
    *(lambda x, f=f, axis=a: f(x > 0, axis=axis) for f in (jnp.any, jnp.all) for a in (0, 1, None)),
    *(lambda x, f=f, axis=a: f(x, axis=axis) for f in (jnp.argmax, jnp.argmin) for a in (0, 1, None)),
    *(lambda x, f=f, axis=a: f(x, axis) for f in (lax.cumsum, lax.cumprod, lax.cummax, lax.cummin) for a in (0, 1)),
    lambda x: lax.cumsum(x, 1, reverse=True),
    lambda x: jnp.sum(x[:0], axis=0),
    lambda x: jnp.max(x[None, :, :], axis=(0, 2), initial=-jnp.inf),
    lambda x: x @ x.T,
    lambda x: x.T @ x[:, 0],
    lambda x: x[0] @ x.T,
    lambda x: x[0] @ x[1],
    lambda x: jnp.einsum("ij,kj->ik", x, x[::-1]),
    lambda x: jnp.einsum("ij,ij->i", x, x),
    lambda x: jnp.einsum("bij,bjk->bik", jnp.stack([x, 2 * x]), jnp.stack([x.T, x.T])),
    lambda x: jnp.outer(x[0], x[1]),
    lambda x: jnp.tensordot(x, x),
]  # fmt: skip


@pytest.mark.slow_cases("in-memory-large")
@pytest.mark.parametrize("matrix", [MATRIX, LARGE], ids=["small", "large"])
def test_reductions_and_products(matrix, plan):
    check(REDUCTIONS, matrix, plan=plan, rtol=1e-12)


def test_reductions_of_special_numbers(plan):
    rows = jnp.asarray([[1.0, np.nan, 3.0, np.nan], [2.0, 2.0, -0.0, 2.0], [-np.inf, np.inf, 0.0, 1.0]])
    check([*REDUCTIONS[6:12], *REDUCTIONS[18:24]], rows, plan=plan)
    integers = jnp.asarray([[3, 1, 3, -7], [2**62, 2**62, 2**62, 5]])
    check([*REDUCTIONS[:12], *REDUCTIONS[18:24]], integers, plan=plan)


SORTS = [
    lambda k, v: jnp.sort(v, axis=0),
    lambda k, v: jnp.argsort(v, axis=0),
    lambda k, v: lax.sort((k, v), dimension=0, num_keys=2),
    lambda k, v: lax.sort((k, jnp.arange(k.size).reshape(k.shape)), dimension=0, num_keys=1, is_stable=True),
]


@pytest.mark.slow_cases("entries-16")
@pytest.mark.parametrize("n", [1, 7, 16, 40])
def test_sorting(n, plan):
    rng = np.random.default_rng(n)
    keys = jnp.asarray(rng.integers(0, 4, size=(n, 3)))
    values = jnp.asarray(np.where(rng.random((n, 3)) < 0.2, np.nan, rng.normal(size=(n, 3))))
    check(SORTS, keys, values, plan=plan)


# --- indices that are known at run time only -------------------------------------------------------------------------

READS = [
    lambda x, i: x[i],
    lambda x, i: lax.dynamic_slice(x, (i, i - 1), (2, 3)),
    lambda x, i: lax.dynamic_index_in_dim(x, i, 1),
    *(lambda x, i, mode=mode: x.at[i].get(mode=mode) for mode in ("clip", "fill")),
    lambda x, i: x.at[jnp.stack([i, i + 1, -i])].get(mode="fill", fill_value=-3.0),
    lambda x, i: x.at[jnp.stack([i, 0 * i])[:, None], jnp.stack([0 * i, i])[None, :]].get(mode="clip"),
    lambda x, i: jnp.take(x, jnp.stack([i, 2 + 0 * i]), axis=1),
    lambda x, i: jnp.take_along_axis(x, jnp.argsort(x, axis=1), axis=1),
    lambda x, i: jax.vmap(lambda row, j: row[j])(x, jnp.arange(x.shape[0], dtype=jnp.int32) + i),
    lambda x, i: x.astype(jnp.int32).at[i].get(mode="fill"),
]
WRITES = [
    lambda x, i: lax.dynamic_update_slice(x, -x[:2, :3], (i, i + 1)),
    *(lambda x, i, mode=mode: x.at[i].set(9.0, mode=mode) for mode in ("clip", "drop")),
    *(lambda x, i, name=name: getattr(x.at[i, 1], name)(2.5) for name in ("add", "multiply", "max", "min")),
    lambda x, i: x.at[jnp.stack([i, i, 0 * i])].add(x[:3]),  # twice to the same place
    lambda x, i: x.at[:, i].set(x[:, 0]),
    lambda x, i: x.at[jnp.stack([i, 1 + 0 * i])[:, None], jnp.stack([0 * i, i])[None, :]].set(7.0, mode="drop"),
    lambda x, i: jax.vmap(lambda row, j: row.at[j].set(0.5))(x, jnp.arange(x.shape[0], dtype=jnp.int32) + i),
    lambda x, i: jax.jacfwd(lambda y: lax.dynamic_slice(y * y, (i, 0 * i), (1, 2)))(x)[0, :, 0],
]


@pytest.mark.slow_cases("in-memory-small")
@pytest.mark.parametrize("matrix", [MATRIX, LARGE], ids=["small", "large"])
def test_indices(matrix, plan):
    program = native.compile(several(*READS, *WRITES), matrix, jnp.int32(0), plan=plan)
    reference = by_xla((*READS, *WRITES))
    for i in (0, 1, 3, -1, -3, 4, 8, 13, 100, -100, 2**31 - 1, -(2**31)):
        found, wanted = program(matrix, jnp.int32(i)), reference(matrix, jnp.int32(i))
        for place, (ours, theirs) in enumerate(zip(found, wanted, strict=True)):
            np.testing.assert_array_equal(ours, theirs, err_msg=f"result {place}, index {i}")


# --- loops and branches ----------------------------------------------------------------------------------------------


def _collatz(n):
    return lax.while_loop(
        lambda s: s[0] != 1, lambda s: (jnp.where(s[0] % 2 == 0, s[0] // 2, 3 * s[0] + 1), s[1] + 1), (n, 0)
    )


def _body(carry, row):
    matrix, total = carry
    total = total + jnp.sum(row)
    return (matrix.at[1].set(matrix[0] + 0.1 * row)[::-1], total), (row * total, matrix[0])


CONTROL = [
    lambda x, i: _collatz(7 + jnp.abs(i)),
    lambda x, i: lax.scan(_body, (x, 0.0), x),
    lambda x, i: lax.scan(_body, (x, 0.0), jnp.tile(x, (9, 1)), reverse=True),
    lambda x, i: lax.scan(lambda c, _: (c * 1.5, c), x, length=0),
    lambda x, i: lax.scan(lambda c, y: (c, c + y), x, x[:, 0]),  # the carry stays
    lambda x, i: lax.fori_loop(
        0, 5 + i, lambda j, c: (c[1], c[0] + j, c[2].at[j % 3].set(j)), (x, 2 * x, x)
    ),  # places change
    lambda x, i: lax.cond(i > 1, lambda y: y.at[0].set(1.0), lambda y: 2 * y, x),
    lambda x, i: lax.switch(i, [lambda y: y, lambda y: y.at[1, 1].add(3.0), lambda y: (y * y).T.reshape(y.shape)], x),
    lambda x, i: lax.fori_loop(
        0, 4, lambda j, y: lax.cond(j % 2 == i % 2, lambda z: z.at[j].set(z[j - 1]), lambda z: z + z[:1], y), x
    ),
    lambda x, i: lax.while_loop(
        lambda c: jnp.sum(jnp.abs(c[0])) < 50.0 * (1 + i % 3), lambda c: (c[0] * 1.2, c[1] + 1), (x + 0.1, 0)
    ),
    lambda x, i: lax.scan(lambda c, y: lax.scan(lambda d, z: (d + z * c[0, 0], d[0]), c, y), x, x),  # nested
    lambda x, i: jax.jit(lambda y: (y, y + i))(x),
    lambda x, i: jax.checkpoint(lambda y: jnp.sin(y) * i)(x),
    lambda x, i: jax.grad(lambda y: jnp.sum(lax.scan(lambda c, r: (jnp.sin(c + r), c), y[0], y)[0]))(x),
    lambda x, i: jax.jacfwd(lambda a: lax.fori_loop(0, 3, lambda j, y: y * a + x, x))(0.5),
    lambda x, i: jax.nn.relu(x) + jax.numpy.linalg.norm(x),  # custom derivatives within
]


@pytest.mark.slow_cases(
    "in-memory-plain-small",
    "in-memory-checked-small",
    "in-memory-plain-large",
    "mixed-checked-small",
    "mixed-plain-small",
)
@pytest.mark.parametrize("matrix", [MATRIX, LARGE], ids=["small", "large"])
@pytest.mark.parametrize("checked", [False, True], ids=["plain", "checked"])
def test_control(matrix, checked, plan):
    program = native.compile(several(*CONTROL), matrix, 0, plan=plan, checked=checked)
    reference = by_xla(tuple(CONTROL))
    for i in (0, 1, 2, 5, -4):
        found, wanted = program(matrix, i), reference(matrix, i)
        for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-11, err_msg=f"i = {i}")


# --- memory that is written in place while somebody still reads it ---------------------------------------------------

ALIASES = [
    lambda x: (x.at[0].set(0.0), x),
    lambda x: (lambda y: (y.at[0].set(5.0), y.T + 1))(x + 1),
    lambda x: (lambda y: (y.reshape(-1).at[3].set(5.0), y))(x + 1),
    lambda x: (lambda y: (lax.optimization_barrier(y).at[0].set(5.0), y * 2))(x + 1),
    lambda x: (lambda y, z: (y.at[1].set(z[0]), z, y))(*jax.jit(lambda x: (x + 1, x + 1))(x)),
    lambda x: (lambda y: lax.dynamic_update_slice(y, y[1:3, 1:3], (0, 0)))(x + 1),  # reads what it overwrites
    lambda x: (lambda y: y.at[jnp.array([2, 0, 1])].set(y[:3]))(jnp.sin(x)),
    lambda x: lax.fori_loop(0, 3, lambda i, c: (c[0].at[i].set(c[1][0]), c[0]), (x, x)),
    lambda x: lax.fori_loop(0, 3, lambda i, c: (c[0] + c[1], c[0] + c[1]), (x, x)),
    lambda x: lax.cond(x[0, 0] > 0, lambda z: (z.at[0].set(0.0), z), lambda z: (z, z.at[1].set(1.0)), x + 1),
    lambda x: (lambda y: (lax.cond(y[0, 0] > 0, lambda z: z.at[0].set(0.0), lambda z: z * 2, y), y))(x + 1),
    lambda x: (lambda y: lax.scan(lambda c, r: (c.at[0].set(r), y[0]), y, y))(x + 1),  # the constant is the carry
    lambda x: (lambda y: (jnp.exp(y), y.at[0].set(1.0), y[1]))(x * 2),  # a lazy reader
]  # fmt: skip


@pytest.mark.parametrize("matrix", [MATRIX, LARGE], ids=["small", "large"])
def test_old_values_survive(matrix, plan):
    wanted = by_xla(tuple(ALIASES))(matrix)
    for function, expected in zip(ALIASES, wanted, strict=True):  # alone: nobody else reads what it writes
        compare(native.compile(function, matrix, plan=plan)(matrix), expected)


# --- rows, lanes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [2, 3, 4, 5, 8])
def test_rows_of_a_frame(columns):
    """An (n, k) frame in vectors: through what an integrator and an orthonormalisation do."""
    frame = jnp.asarray(np.random.default_rng(2).normal(size=(3, columns)))
    matrix = jnp.asarray(np.random.default_rng(3).normal(size=(3, 3)))

    def function(frame, matrix, n):
        def step(i, q):
            q = q + 0.1 * (matrix @ q) + 0.01 * jnp.stack([q[1], q[2] * i, -q[0]])
            q = jnp.concatenate([q[:1], jnp.sin(q[1:])]) / (1 + jnp.max(jnp.abs(q), axis=0))[None, :]
            return lax.cond(i % 2 == 0, lambda q: q * 1.5, lambda q: q.at[1].add(q[0]), q)

        q = lax.fori_loop(0, n, step, frame)
        lengths = jnp.sqrt(jnp.sum(q * q, axis=0))
        picture = jnp.pad(q, ((1, 0), (0, 0)))[::-1].reshape(2, 2, columns).transpose(1, 0, 2)
        return (
            q,
            lengths,
            q.T @ q,
            q[:, 0],
            q @ lengths,
            picture,
            jnp.where(q > 0, q, 1.0).sum(),
            q.reshape(-1),
            q[n % 3],
        )

    check([function], frame, matrix, 5, plan=Options(64, 1), columns=columns, rtol=1e-12)


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_lanes_are_vmap(lanes):
    """Loops whose lengths differ, branches that differ, records."""

    def function(x, rho):
        def step(c):
            i, x = c
            x = jnp.stack([x[1], rho * x[0] - 0.1 * x[1]]) * 0.9
            return i + 1, lax.cond(x[0] > 0, lambda x: x + 0.25, lambda x: -x, x)

        i, end = lax.while_loop(lambda c: (c[0] < 40) & (jnp.abs(c[1][0]) < 3), step, (0, x))
        kind = lax.switch(i % 3, [lambda: 1.0, lambda: end[0], lambda: end[1] * 2])
        return i, end, kind, lax.scan(lambda c, _: (c * 0.5, c[0]), end, length=9)

    x = jnp.asarray(np.random.default_rng(4).normal(size=(2, lanes)))
    rho = jnp.linspace(0.5, 1.5, lanes)
    closed = jax.make_jaxpr(function)(x[:, 0], rho[0])
    found = native.Compiled(closed, lanes=lanes, wide=(True, True), plan=Options(64, 1))(x, rho)
    wanted = jax.tree.leaves(jax.vmap(function, in_axes=-1, out_axes=-1)(x, rho))
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13)


def test_lanes_of_large_arrays():
    function = lambda x: jnp.cumsum(x * 2)  # noqa: E731
    x = jnp.asarray(np.random.default_rng(5).normal(size=(100, 4)))
    (found,) = native.Compiled(jax.make_jaxpr(function)(x[:, 0]), lanes=4, wide=(True,), plan=Options(64, 1))(x)
    np.testing.assert_allclose(found, jax.vmap(function, in_axes=-1, out_axes=-1)(x), rtol=1e-12)


def test_what_is_not_taken_is_named():
    with pytest.raises(native.UnsupportedError, match="elements of type complex128"):
        native.compile(lambda x: x * 1j, 1.0)
    with pytest.raises(native.UnsupportedError, match="the primitive fft|elements of type complex"):
        native.compile(lambda x: jnp.abs(jnp.fft.fft(x)), jnp.ones(4))


def test_operands_must_have_their_shapes():
    double = native.compile(lambda x: 2 * x, jnp.ones(3))
    with pytest.raises(ValueError, match=r"operand 0 must have shape \(3,\); got \(4,\)"):
        double(jnp.ones(4))
