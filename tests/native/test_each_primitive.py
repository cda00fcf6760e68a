"""Each primitive that the native compiler knows, against XLA: edge values, edge shapes, memory that is shared."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from against_xla import PLANS, difference, differences
from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options

# --- single entries --------------------------------------------------------------------------------------------------

_FLOATS = [0.0, -0.0, 1.0, -1.0, 0.5, -0.75, 2.5, -2.5, 3.0, 1e10, -3e19, np.inf, -np.inf, np.nan]
_SMALL_INTEGERS = [0, 1, 2, 3, 5, 31, 63, 64, 100]


def _pairs(numbers, dtype):
    """All pairs of these numbers."""
    x, y = np.meshgrid(np.asarray(numbers, dtype), np.asarray(numbers, dtype))
    return x.ravel(), y.ravel()


def _integers(dtype):
    limits = np.iinfo(dtype)
    signed = [-1, -2, -7, limits.min, limits.min + 1] if limits.min else [limits.max // 2 + 1]
    return [x for x in (*_SMALL_INTEGERS[:6], *signed, limits.max, limits.max - 1) if x <= limits.max]


_COMPARISONS = {name: getattr(lax, name) for name in ("lt", "le", "gt", "ge", "eq", "ne")}
_OF_TWO = {name: getattr(lax, name) for name in ("add", "sub", "mul", "div", "rem", "max", "min")} | _COMPARISONS
_TYPES = (np.float32, np.float64, np.int8, np.int32, np.int64, np.uint8, np.uint32, np.uint64)
_FLOAT_TYPES, _INTEGER_TYPES = _TYPES[:2], _TYPES[2:]


_IN_TOTAL_ORDER = (lax.lt_to_p, lax.le_to_p, lax.eq_to_p)  # of searchsorted, interp, digitize


def _conversions(x):
    return {f"to {np.dtype(t)}": lax.convert_element_type(x, t) for t in (*_TYPES, np.bool_)}


def _floats_of_two(x, y):
    found = {name: f(x, y) for name, f in _OF_TWO.items()}
    found |= {of.name: of.bind(x, y) for of in _IN_TOTAL_ORDER}
    found |= {"atan2": lax.atan2(x, y), "nextafter": lax.nextafter(x, y), "pow": lax.pow(x, y)}
    found |= {"select": lax.select(x < y, x, y), "clamp": lax.clamp(-jnp.ones_like(x), x, jnp.abs(y))}
    return found


_UNARY = (
    "neg abs sign floor ceil sqrt rsqrt cbrt exp exp2 expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh "
    "acosh atanh erf erfc lgamma logistic is_finite square log2 one_minus_square"
).split()
_UNARY = [name for name in _UNARY if hasattr(lax, name)]  # some are younger than jax 0.8


def _floats_of_one(x):
    found = {name: getattr(lax, name)(x) for name in _UNARY if name not in ("sin", "cos", "tan", "lgamma")}
    modest = jnp.clip(x, -100.0, 100.0)
    found |= {name: getattr(lax, name)(modest) for name in ("sin", "cos", "tan", "lgamma")}
    found |= {f"^{n}": lax.integer_pow(x, n) for n in (-3, -1, 0, 1, 2, 3, 7)}
    found |= {"round": lax.round(x), "even": lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN)}
    bits = {4: np.int32, 8: np.int64}[x.dtype.itemsize]
    found |= {"bits": lax.bitcast_convert_type(lax.abs(x), bits), "copy": lax.stop_gradient(jnp.copy(x))}
    found |= {"/8": x / 8, "+0": x + 0, "*1": x * 1, "max": jnp.maximum(x, 1), "min": jnp.minimum(0.5, x)}
    limits = np.finfo(x.dtype)
    return found | {"same": lax.reduce_precision(x, limits.nexp, limits.nmant)} | _conversions(x)


def _integers_of_two(x, y):
    found = {name: f(x, y) for name, f in _OF_TWO.items()}
    found |= {"and": x & y, "or": x | y, "xor": x ^ y}
    for name in ("shift_left", "shift_right_logical", "shift_right_arithmetic"):
        found |= {name: getattr(lax, name)(x, y)}
    return found | {"select": lax.select_n(lax.convert_element_type(y & 1, np.int32), x, y)}


def _integers_of_one(x):
    found = {name: getattr(lax, name)(x) for name in ("neg", "sign", "population_count", "clz", "square")}
    found |= {} if x.dtype.kind == "u" else {"abs": lax.abs(x)}
    found |= {f"^{n}": lax.integer_pow(x, n) for n in (0, 1, 2, 5)}
    found |= {"not": ~x, "+0": x + 0, "*1": x * 1}
    for by in (0, 1, x.dtype.itemsize * 8 - 1, x.dtype.itemsize * 8):
        found |= {f"<<{by}": x << by, f">>{by}": x >> by, f">>>{by}": lax.shift_right_logical(x, x.dtype.type(by))}
    return found | _conversions(x)


def _conditions(x, y):
    found = {name: f(x, y) for name, f in _COMPARISONS.items()}
    found |= {"and": x & y, "or": x | y, "xor": x ^ y, "not": ~x, "max": lax.max(x, y), "min": lax.min(x, y)}
    found |= {"select": jnp.where(x, y, ~y), "both": jnp.where(x, True, y), "either": jnp.where(x, y, False)}
    return found | _conversions(x)


ENTRYWISE = {
    **{f"{np.dtype(t)}, one": (_floats_of_one, (np.asarray(_FLOATS, t),)) for t in _FLOAT_TYPES},
    **{f"{np.dtype(t)}, two": (_floats_of_two, _pairs(_FLOATS, t)) for t in _FLOAT_TYPES},
    **{f"{np.dtype(t)}, one": (_integers_of_one, (np.asarray(_integers(t), t),)) for t in _INTEGER_TYPES},
    **{f"{np.dtype(t)}, two": (_integers_of_two, _pairs(_integers(t), t)) for t in _INTEGER_TYPES},
    "bool": (_conditions, _pairs([False, True], np.bool_)),
}


@pytest.mark.parametrize("case", ENTRYWISE)
def test_entrywise(case):
    function, operands = ENTRYWISE[case]
    expected = jax.jit(function)(*operands)
    few = [x[:64] for x in operands]
    wrong = {
        "loops": differences(function, *operands, plan=Options(1, 1), expected=expected),
        "entries": differences(function, *few, plan=Options(64, 0), expected=jax.tree.map(lambda x: x[:64], expected)),
    }
    known = native.compile(lambda: jax.jit(function)(*few), plan=Options(64, 0))()  # folded while compiling, by NumPy
    for name, x in expected.items():
        if (how := difference(x[:64], known[name])) is not None:
            wrong[f"folded {name}"] = how
    assert not any(wrong.values()), wrong


def test_denormal_numbers_are_kept():
    """XLA flushes them to zero; NumPy does not."""
    x = np.array([5e-324, 1e-310, -1e-310, 2.3e-308])

    def f(x):
        return {
            "half": x / 2,
            "twice": x * 2,
            "sum": x + x,
            "sqrt": jnp.sqrt(jnp.abs(x)),
            "min": jnp.min(x),
            "<": x < 0,
        }

    for plan in PLANS.values():
        got = native.compile(f, x, plan=plan)(x)
        expected = {"half": x / 2, "twice": x * 2, "sum": x + x, "sqrt": np.sqrt(abs(x)), "min": x.min(), "<": x < 0}
        assert all(np.array_equal(got[name], expected[name]) for name in expected)
    small = np.array([1e-40, 1e-42], np.float32)
    got = native.compile(lambda x: x / np.float32(2.0**-140), small)(small)
    assert np.array_equal(got, small / np.float32(2.0**-140))


def test_rows_are_added_one_after_the_other():
    x = np.random.default_rng(3).normal(size=(20, 30))
    assert np.array_equal(native.compile(lambda x: x.sum(0), x, plan=Options(1, 2))(x), functools.reduce(np.add, x))


def test_terms_of_a_sum_are_not_reassociated():
    """Partial sums are taken side by side, and nothing else is moved; XLA is less strict."""
    x = np.linspace(1, 3, 20)
    got = native.compile(lambda x: ((x + 1e16) - 1e16).sum(), x, plan=Options(1, 2))(x)
    assert got == ((x + 1e16) - 1e16).sum()


# --- arrays ----------------------------------------------------------------------------------------------------------

_RANDOM = np.random.default_rng(20261125)


def _normal(*shape):
    return _RANDOM.normal(size=shape)


def _whole(*shape, high=10):
    return _RANDOM.integers(-high, high, shape)


def _moves(x, y):
    """x: (3, 4), y: (4,)."""
    z = x * 2  # lazy where it is large
    return {
        "reshape": z.reshape(2, 6),
        "flat": z.reshape(-1),
        "axes": z[None, :, None],
        "squeeze": jnp.squeeze(z[:1] * 1, 0),
        "broadcast": jnp.broadcast_to(z[:, None], (3, 2, 4)),
        "rows": jnp.broadcast_to(jnp.sin(y), (5, 4)),
        "column": jnp.broadcast_to(x[:, :1], (3, 5)),
        "slice": z[1:, ::2],
        "rev": z[::-1, ::-1],
        "transpose": z.T,
        "permuted": jnp.transpose(z.reshape(3, 2, 2), (2, 0, 1)),
        "concatenate": jnp.concatenate([z, x, y[None]], 0),
        "concatenate 1": jnp.concatenate([z, x[:, :1]], 1),
        "stack": jnp.stack([y, jnp.sin(y), y[::-1]]),
        "stack 1": jnp.stack([y, y * 3], 1),
        "split": jnp.split(z, [1, 3], axis=1),
        "pad": lax.pad(z, np.float64(7), [(1, 2, 0), (0, 1, 2)]),
        "cropped": lax.pad(z, np.float64(7), [(-1, 2, 1), (2, -3, 1)]),
        "cropped away": lax.pad(y, np.float64(7), [(-6, 3, 0)]),
        "iota": jnp.arange(7)[None] + lax.broadcasted_iota(np.int64, (3, 7), 0),
        "iota float": lax.iota(np.float32, 20),
        "roll": jnp.roll(z, 1, 0),
        "where": jnp.where(z > 0, z, y[None]),
        "scalar": (z.sum() * 2).reshape(1, 1),
        "barrier": lax.optimization_barrier((z, y * 2)),
        "unstacked": [a + 1 for a in z],
        "diagonal": jnp.diag(y) + jnp.eye(4),
        "triangle": jnp.tril(jnp.outer(y, y)),
    }


def _empty(x, y):
    """x: (0, 3), y: (0,)."""
    return {
        "sum": x.sum(),
        "sum 0": x.sum(0),
        "sum 1": x.sum(1),
        "prod": y.prod(),
        "any": (x > 0).any(0),
        "all": (y > 0).all(),
        "max": jnp.max(x, 1),
        "limits": lax.reduce_max(x, (0,)),
        "least": lax.reduce_min(y, (0,)),
        "joined": jnp.concatenate([x, jnp.ones((2, 3))]),
        "plus": x + 1,
        "reshaped": x.reshape(3, 0).T,
        "dot": x.T @ x,
        "rows": x @ jnp.ones((3, 2)),
        "sorted": jnp.sort(y),
        "cumsum": jnp.cumsum(x, 0),
        "padded": lax.pad(y, np.float64(2), [(1, 2, 0)]),
        "taken": jnp.ones(4)[jnp.zeros(0, int)],
        "put": jnp.ones(4).at[jnp.zeros(0, int)].add(y),
        "slice": lax.dynamic_slice(jnp.ones(4), (2,), (0,)),
        "scan": lax.scan(lambda c, a: (c + a.sum(), a * 2), 1.0, x),
        "put all": jnp.ones((40, 3)).at[40:].set(x),
        "broadcast": jnp.broadcast_to(x[:, None], (0, 2, 3)),
        "argmax": jnp.argmax(x, 1),
        "big": jnp.ones((3, 0, 50)) + 1,
        "big scan": lax.scan(lambda c, a: (c + 1, c), jnp.ones(40), y),
    }


def _reductions(x, i, c):
    """x: floats, i: integers, c: conditions, of shape (3, 4, 2)."""
    found = {}
    for axes in (None, 0, 2, (0, 1), (0, 2)):
        found |= {
            f"sum {axes}": x.sum(axes),
            f"lazy sum {axes}": jnp.sin(x).sum(axes),
            f"prod {axes}": x.prod(axes),
            f"max {axes}": x.max(axes),
            f"min {axes}": x.min(axes),
            f"any {axes}": c.any(axes),
            f"all {axes}": c.all(axes),
            f"int sum {axes}": i.sum(axes),
            f"int max {axes}": i.max(axes),
            f"int min {axes}": i.min(axes),
            f"int prod {axes}": i.prod(axes),
        }
        over = tuple(range(3)) if axes is None else axes if isinstance(axes, tuple) else (axes,)
        for name in ("and", "or", "xor"):
            found[f"{name} {axes}"] = getattr(lax, f"reduce_{name}")(i, over)
            found[f"{name} {axes} of conditions"] = getattr(lax, f"reduce_{name}")(c, over)
    return found


def _along_one_axis(x, i):
    """x: floats, i: integers, of shape (3, 4, 2)."""
    found = {}
    for axis in (0, 2):
        for name in ("cumsum", "cumprod", "cummax", "cummin"):
            for back in (False, True):
                found[f"{name} {axis} {back}"] = getattr(lax, name)(x, axis, reverse=back)
                found[f"integer {name} {axis} {back}"] = getattr(lax, name)(i, axis, reverse=back)
        for name in ("argmax", "argmin"):
            function = getattr(lax, name)
            found[f"{name} {axis}"] = [function(x, axis, np.int32), function(i, axis, np.int64)]
    return found


def _products(x, y, v, i):
    """x: (3, 4), y: (4, 5), v: (4,), i: integers (3, 3)."""
    batch = jnp.stack([x, 2 * x])
    return {
        "matrix": x @ y,
        "vector": x @ v,
        "row": v @ y,
        "inner": v @ v,
        "transposed": x.T @ x,
        "outer": jnp.outer(v, v),
        "batch": jnp.einsum("bij,bkj->bik", batch, batch),
        "last": jnp.einsum("bij,jk->bik", batch, y),
        "trace": jnp.einsum("bij,bij->", batch, batch),
        "chain": jnp.einsum("ij,jk,j->ik", x, y, v),
        "integers": i @ i,
        "lazy": jnp.sin(x) @ jnp.cos(y),
        "swapped": jnp.einsum("ij,jk->ki", x, y),
        "mixed": lax.dot(x.astype(np.float32), y.astype(np.float32), preferred_element_type=np.float64),
    }


_NAN = np.where(_whole(3, 4, 2, high=3) == 2, np.nan, _whole(3, 4, 2, high=3).astype(float))

# --- indices ---------------------------------------------------------------------------------------------------------

_MODES = ("clip", "fill", "promise_in_bounds")


def _indices(x, m, at, pairs):
    """x: (9,), m: (4, 5); `at` and `pairs` are indices, some of them out of bounds or negative."""
    z, found = jnp.sin(x), {}
    for mode in _MODES:
        inside = mode == "promise_in_bounds"
        a, p = (jnp.abs(at) % 9, jnp.abs(pairs) % 4) if inside else (at, pairs)
        found |= {
            f"take {mode}": x.at[a].get(mode=mode),
            f"lazy {mode}": z.at[a].get(mode=mode),
            f"rows {mode}": m.at[a % 6 if not inside else a % 4].get(mode=mode),
            f"columns {mode}": m.at[:, p[:, 1]].get(mode=mode),
            f"places {mode}": m.at[p[:, 0], p[:, 1]].get(mode=mode),
            f"one {mode}": x.at[a[0]].get(mode=mode),
            f"integers {mode}": (a * 3).at[a % 10].get(mode=mode),
            f"unsigned {mode}": (jnp.arange(9, dtype=np.uint32) * 2).at[a].get(mode=mode),
            f"conditions {mode}": (x > 0).at[a].get(mode=mode),
        }
        for change in ("set", "add", "mul", "max", "min"):
            unique = jnp.array([0, -9, 100, 4]) if not inside else jnp.array([0, 3, 8, 4])
            places = unique if change == "set" else a
            found |= {
                f"{change} {mode}": getattr(x.at[places], change)(jnp.cos(places.astype(float)), mode=mode),
                f"{change} a number {mode}": getattr(z.at[places], change)(0.5, mode=mode),
                f"{change} one {mode}": getattr(x.at[a[1]], change)(9.0, mode=mode),
                f"{change} rows {mode}": getattr(m.at[places[:1] % 4], change)(m[:1] * 2, mode=mode),
                f"{change} many {mode}": getattr(x.at[jnp.arange(300) % (27 if inside else 99) // 3], change)(
                    jnp.cos(jnp.arange(300.0)), mode=mode
                ),
                f"{change} of integers {mode}": getattr(jnp.arange(9).at[places], change)(places * 7, mode=mode),
                f"{change} column {mode}": getattr(m.at[:, p[0, 0]], change)(m[:, 0], mode=mode),
            }
    found["filled"] = x.at[at].get(mode="fill", fill_value=-5.0)
    found["along"] = jnp.take_along_axis(m, jnp.abs(pairs[:4]) % 5, 1)
    for i in (0, 2, -1, -100, 100):
        found |= {
            f"dynamic_slice {i}": lax.dynamic_slice(x, (at[0] * 0 + i,), (4,)),
            f"of a matrix {i}": lax.dynamic_slice(m, (at[0] * 0 + i, at[0] * 0 - i), (2, 3)),
            f"of lazy {i}": lax.dynamic_slice(z, (at[0] * 0 + i,), (8,)),
            f"update {i}": lax.dynamic_update_slice(x, z[:3], (at[0] * 0 + i,)),
            f"update all {i}": lax.dynamic_update_slice(m, m * 2, (at[0] * 0 + i, at[0] * 0)),
            f"index {i}": lax.dynamic_index_in_dim(m, at[0] * 0 + i, 1),
            f"known {i}": lax.dynamic_slice(x, (i,), (4,)),
        }
    for dtype in (np.int8, np.int32, np.uint32, np.uint8, np.uint64):
        found[f"{np.dtype(dtype)}"] = lax.dynamic_slice(x, (at[2].astype(dtype),), (4,))
        found[f"take {np.dtype(dtype)}"] = x.at[jnp.abs(at).astype(dtype)].get(mode="clip")
    return found


def _few_indices(m, at):
    """m: (4, 5); `at`: three indices, some of them out of bounds or negative."""
    found = {}
    for mode in _MODES:
        i = at % 4 if mode == "promise_in_bounds" else at
        found |= {
            f"take {mode}": m.at[i].get(mode=mode),
            f"columns {mode}": m.at[:, i].get(mode=mode),
            f"add {mode}": m.at[i].add(m[:3], mode=mode),
            f"max {mode}": m.at[i, i].max(0.5, mode=mode),
            f"set a column {mode}": m.at[:, i[2]].set(m[:, 1], mode=mode),
        }
    place = at[0], at[1]
    found["slice"] = lax.dynamic_slice(m, place, (2, 3))
    return found | {"update": lax.dynamic_update_slice(m, m[:2, :3] * 2, place)}


def _sorts(x, i, many):
    """x: floats with nan, i: integers with ties; many: 50 floats."""
    return {
        "sort": jnp.sort(x),
        "integers": jnp.sort(i),
        "argsort": jnp.argsort(x),
        "ties": jnp.argsort(i),
        "down": jnp.sort(x, descending=True),
        "two keys": lax.sort((i, x, jnp.arange(x.size)), num_keys=2),
        "follow": lax.sort((i, x, jnp.arange(x.size)), num_keys=1),
        "many": jnp.sort(many),
        "places": jnp.argsort(many),
        "axis 0": jnp.sort(x.reshape(2, -1), 0),
        "axis 1": lax.sort((i.reshape(3, -1), x.reshape(3, -1)), dimension=1),
        "tied": jnp.argsort((many * 3).astype(int)),
        "conditions": jnp.sort(i > 0),
        "float32": jnp.sort(many.astype(np.float32)),
        "unsigned": jnp.sort(i.astype(np.uint32)),
        "median": jnp.median(many),
        "a place": jnp.searchsorted(jnp.sort(many), x),
        "a table": jnp.interp(many, jnp.linspace(-1.0, 1.0, 7), many[:7]),
        "bins": jnp.digitize(many, jnp.linspace(-1.0, 1.0, 7)),
    }


# --- loops and branches ----------------------------------------------------------------------------------------------


def _scans(x, n):
    """x: (12,), n: 3."""
    found = {}
    for length in (0, 1, 3, 50):
        xs = jnp.sin(jnp.arange(length * 2.0)).reshape(length, 2)
        for reverse in (False, True):
            found |= {
                f"sum {length} {reverse}": lax.scan(
                    lambda c, a: (c * 0.5 + a.sum() + x[n], (c, a * x[n])), 1.0, xs, reverse=reverse
                ),
                f"array {length} {reverse}": lax.scan(
                    lambda c, a: ((c[1], c[0] * 0.9 + a[0], c[2]), (c[0], c[2] * a[1])),
                    (x, x + 1, x * 2),
                    xs,
                    reverse=reverse,
                ),
                f"in place {length} {reverse}": lax.scan(
                    lambda c, i: (c.at[i % 12].add(c[(i + 1) % 12]), c.sum()), x, jnp.arange(length), reverse=reverse
                ),
                f"rows {length} {reverse}": lax.scan(lambda c, a: (c, a[::-1] + c[:2]), x, xs, reverse=reverse),
            }
    found["no xs"] = lax.scan(lambda c, _: (c * 2, None), x, None, length=7)
    found["associative"] = lax.associative_scan(jnp.add, x)
    found["map"] = lax.map(lambda a: a * x, x[:5])
    return found


def _whiles(x, n):
    """x: (12,), n: 3."""

    def swap(c):
        i, a, b = c
        return i + 1, b, a

    def nested(c):
        i, a = c
        inner = lax.while_loop(lambda s: s[0] < i, lambda s: (s[0] + 1, s[1].at[s[0]].set(s[1].sum() * 0.1)), (0, a))[1]
        return i + 1, lax.cond(
            i % 2 == 0,
            lambda a: a.at[0].add(1.0),
            lambda a: lax.scan(lambda c, _: (c[::-1], c.sum()), a, length=3)[0],
            inner,
        )

    def old_still_needed(c):
        i, a = c
        new = a.at[i].set(7.0)
        return i + 1, new.at[i + 1].add(a[i])

    return {
        "swap": lax.while_loop(lambda c: c[0] < n, swap, (0, x, x * 2)),
        "same twice": lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1].at[0].add(1.0), c[2]), (0, x, x)),
        "both written": lax.while_loop(
            lambda c: c[0] < n, lambda c: (c[0] + 1, c[1].at[0].add(1.0), c[2].at[1].add(2.0)), (0, x, x)
        ),
        "nested": lax.while_loop(lambda c: c[0] < n + 4, nested, (0, x)),
        "old": lax.while_loop(lambda c: c[0] < n, old_still_needed, (0, jnp.sin(x))),
        "never": lax.while_loop(lambda c: c[0] < 0, swap, (n, x, x + 1)),
        "fixed": lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1], c[2] + c[1]), (0, x, x)),
        "constant": lax.while_loop(lambda c: c[1].sum() < 100 + x.sum(), lambda c: (c[0], c[1] + jnp.abs(x)), (x, x)),
        "collapsed": lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1], c[1]), (0, x, x + 1)),
        "rotated": lax.fori_loop(0, n, lambda i, c: (c[1], c[2], c[0].at[i].set(0.0)), (x, x + 1, x + 2)),
        "known at the end": lax.while_loop(
            lambda c: c[0] < n, lambda c: (c[0] + 1, True, np.inf, 7), (0, x[0] > 9, x[0], n)
        ),
        "initial kept": (lax.fori_loop(0, n, lambda i, c: c.at[i].set(0.0), jnp.sin(x)), jnp.sin(x)),
        "mirrored": lax.fori_loop(0, n, lambda i, c: c.at[i].set(c[::-1][i] + 1), x),
        "shifted": lax.fori_loop(0, n, lambda i, c: jnp.roll(c, 1).at[i].add(c[0]), x),
    }


def _whiles_side_by_side(x, n):
    """Loops that end at different turns under vmap; x: (12,), n: 3."""

    def until(limit, x):
        return lax.while_loop(
            lambda c: (c[0] < limit) & (c[1][0] < 3), lambda c: (c[0] + 1, c[1] * 1.1 + x[::-1], c[2]), (0, x, x)
        )

    def nested(limit):
        return lax.while_loop(lambda c: c[0] < limit, lambda c: (c[0] + 1, c[1] + until(c[0], x)[1].sum()), (0, 0.0))

    def swapped(limit, x):
        return lax.while_loop(lambda c: c[0] < limit, lambda c: (c[0] + 1, c[2], c[1].at[c[0]].set(7.0)), (0, x, x + 1))

    limits, rows = jnp.arange(5) % 4, jnp.outer(jnp.arange(5.0), x)
    return {
        "one axis": jax.vmap(until)(limits, rows),
        "two axes": jax.vmap(jax.vmap(until), (0, None))(jnp.stack([limits, limits + n]), rows),
        "shared": jax.vmap(until, (0, None))(limits, x),
        "nested": jax.vmap(nested)(limits),
        "change places": jax.vmap(swapped)(limits, rows),
        "turns": jax.vmap(lambda y: lax.while_loop(lambda c: c[0] < 0.9, lambda c: (c[0] + 0.1, c[1] + 1), (y, 0)))(x),
        "until n": jax.vmap(until, (None, 0))(n, rows),
    }


def _branches(x, n):
    """x: (12,), n: 3."""
    found = {}
    several = [
        lambda a, b: (a, b),
        lambda a, b: (b, a),
        lambda a, b: (a.at[0].set(5.0), a),
        lambda a, b: (a + b, a.at[1].add(b[0])),
        lambda a, b: (b, b),
    ]
    y = jnp.cos(x)
    for index in (-3, 0, 1, 2, 3, 4, 9):
        which = n * 0 + index
        found[f"switch {index}"] = lax.switch(which, several, x, y)
        found[f"of one {index}"] = lax.switch(which, several, y, y)
        z = y * 2
        found[f"kept {index}"] = (lax.switch(which, several, z, z[::-1]), z, z.sum())
    found["platform"] = lax.platform_dependent(x, cuda=lambda a: a - 1, cpu=lambda a: a + 1, default=lambda a: a * 2)
    found["other platform"] = lax.platform_dependent(x, cuda=lambda a: a - 1, default=lambda a: a * 2)
    for yes in (True, False):
        condition = (n == 3) == yes
        w = x * 3
        mirror = w[::-1]  # reads w, and is used after the branch that writes over it
        found[f"cond {yes}"] = (lax.cond(condition, lambda a: a.at[2].set(1.0), lambda a: a, w), mirror + 1, mirror[0])
        found[f"where {yes}"] = jnp.where(condition, x, y)
        found[f"integers {yes}"] = lax.cond(condition, lambda i: (i, i + 1), lambda i: (i * 2, i), n)
        found[f"nested {yes}"] = lax.cond(
            condition, lambda a: lax.cond(a[0] > 0, lambda a: a.at[0].set(0.0), lambda a: a * 2, a), lambda a: -a, y
        )
    return found


def _aliases(x, n):
    """Memory that several values share, and one of them is written. x: (12,), n: 3."""
    y = jnp.sin(x)
    view = y.reshape(3, 4)
    mirror = y[::-1]  # lazy and cheap: not in memory until it is written
    changed = mirror.at[n].set(100.0)
    inner = jax.jit(lambda a, b: (a.at[0].set(1.0), b.at[1].set(2.0), a + b))
    z = jnp.cos(x)
    barrier, _ = lax.optimization_barrier((z, n))
    lazy = y * z
    outer = lazy + 1
    put = lazy.at[n].set(50.0)
    w = jnp.exp(x * 0.1)
    sliced = w[2:8]
    first = w.at[3].set(-1.0)
    column = jnp.cos(y).reshape(4, 3)
    twice = column.at[n % 4].set(column[0])
    part = lax.dynamic_slice(y, (n,), (5,))  # is not read within the loop, but shares memory with what is
    branch = lambda i, a: lax.cond(i == 1, lambda y, a: a + y[0], lambda y, a: y * a[0], y, a)  # noqa: E731
    looped = lax.fori_loop(0, n, branch, jnp.tanh(x))
    chain = x
    for k in range(6):
        chain = chain.at[k].set(chain[k + 1] * 2)
    return {
        "part": (looped, part, part + 1),
        "view": (view.at[1, n].set(9.0), y, view),
        "mirror": (changed, mirror, y, mirror.at[0].set(3.0)),
        "jit": inner(y, y),
        "jit of a view": inner(mirror, y),
        "barrier": (barrier.at[0].set(4.0), z, barrier),
        "lazy": (put, outer, lazy),
        "slice": (first, sliced + 1, sliced.at[0].set(8.0)),
        "rows": (twice, column),
        "itself": lax.dynamic_update_slice(y, y[:4], (n,)),
        "overlap": y.at[n + jnp.arange(4)].set(y[:4]),
        "chain": chain,
        "swap": y.at[jnp.array([0, 11])].set(y[jnp.array([11, 0])]),
        "reversed": y.at[:].set(y[::-1]),
        "loop": (lax.fori_loop(0, n, lambda i, a: a.at[i].set(mirror[i] + a[i + 1]), mirror), mirror),
        "scan over itself": lax.scan(lambda c, a: (c.at[0].add(a), c[1] + a), y, y),
        "in a loop": lax.fori_loop(0, n, lambda i, a: inner(a, a)[0] + inner(a, a)[2].at[i].set(a[i]), y),
    }


@jax.custom_jvp
def _guarded(x):
    return jnp.where(x > 0, jnp.sqrt(jnp.abs(x)), 0.0)


@_guarded.defjvp
def _(primals, tangents):
    (x,), (dx,) = primals, tangents
    return _guarded(x), dx * 3


@jax.custom_vjp
def _doubled(x):
    return x * 2


_doubled.defvjp(lambda x: (x * 2, x), lambda x, g: (g * jnp.cos(x),))


def _by_numpy(x, coefficients):
    return jnp.polyval(np.array(coefficients[::-1]), x)


_polynomial = getattr(lax, "polynomial", _by_numpy)  # from jax 0.12 on


def _derivatives(x, n):
    """x: (12,), n: 3."""

    def program(x):
        def step(c, i):
            c = jnp.where(i % 2 == 0, c + 0.1 * jnp.sin(jnp.roll(c, 1)), c * 0.9)
            return c, _guarded(c.sum()) + _doubled(c[0])

        c, ys = lax.scan(step, x, jnp.arange(5))
        return lax.cond(n > 2, lambda c: c * ys.sum(), lambda c: c, c)

    pushed = lambda x: lax.while_loop(lambda s: s[0] < n, lambda s: (s[0] + 1, s[1] * jnp.cos(s[1][::-1])), (0, x))[1]  # noqa: E731
    return {
        "value": program(x),
        "grad": jax.grad(lambda x: program(x).sum())(x),
        "jvp": jax.jvp(pushed, (x,), (x * 2,)),
        "jacobian": jax.jacfwd(pushed)(x),
        "vmap": jax.vmap(pushed)(jnp.stack([x, x + 1])),
        "custom": (_guarded(x), _doubled(x), jax.grad(lambda x: _doubled(x).sum())(x)),
        "hessian": jax.hessian(lambda x: jnp.sin(x[:3]).prod() + _guarded(x[3]))(x[:4]),
        "checkpoint": jax.grad(jax.checkpoint(lambda x: jnp.sin(jnp.sin(x)).sum()))(x),
        "polynomial": (
            _polynomial(x, [0.5, -1.0, 2.0, 0.25]),
            jax.grad(lambda x: _polynomial(x, [1.0, 2.0, 3.0]))(x[0]),
        ),
        "reverse jacobian": jax.jacrev(lambda x: jnp.sin(x[:4]) * x[4])(x[:5]),
    }


_X = _normal(12)
ARRAYS = {
    "moves": (_moves, (_normal(3, 4), _normal(4))),
    "empty": (_empty, (np.zeros((0, 3)), np.zeros(0))),
    "reductions": (_reductions, (_normal(3, 4, 2), _whole(3, 4, 2), _whole(3, 4, 2) > 0)),
    "reductions of nan": (_reductions, (_NAN, _whole(3, 4, 2, high=2), _whole(3, 4, 2) > 8)),
    "along one axis": (_along_one_axis, (_normal(3, 4, 2), _whole(3, 4, 2))),
    "along one axis of nan": (_along_one_axis, (_NAN, _whole(3, 4, 2, high=2))),
    "products": (_products, (_normal(3, 4), _normal(4, 5), _normal(4), _whole(3, 3))),
    "indices": (_indices, (_normal(9), _normal(4, 5), np.array([2, -3, 50, 8, -100, 0]), _whole(5, 2, high=7))),
    "few indices": (_few_indices, (_normal(4, 5), np.array([2, -3, 50]))),
    "sorts": (
        _sorts,
        (np.array([2.0, np.nan, -np.inf, 0.0, -0.0, np.nan, np.inf, 2, -7, 0, 1, 1]), _whole(12, high=3), _normal(50)),
    ),
    "scans": (_scans, (_X, 3)),
    "whiles": (_whiles, (_X, 3)),
    "whiles side by side": (_whiles_side_by_side, (_X, 3)),
    "branches": (_branches, (_X, 3)),
    "aliases": (_aliases, (_X, 3)),
    "derivatives": (_derivatives, (_X, 3)),
}


@functools.cache
def _by_xla(case):
    function, operands = ARRAYS[case]
    return jax.jit(function)(*operands)


@pytest.mark.slow_cases(
    "reductions-buffers",
    "reductions-mixed",
    "indices-buffers",
    "indices-mixed",
    "sorts-buffers",
    "sorts-mixed",
    "scans-buffers",
    "whiles side by side-buffers",
    "derivatives-buffers",
    "derivatives-mixed",
    "reductions of nan-buffers",
    "reductions of nan-mixed",
    "along one axis of nan-buffers",
    "along one axis of nan-mixed",
    "indices-entries",
    "along one axis-buffers",
    "scans-mixed",
    "derivatives-entries",
    "sorts-entries",
    "scans-entries",
)
@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("case", ARRAYS)
def test_arrays(case, plan):
    function, operands = ARRAYS[case]
    wrong = differences(function, *operands, plan=PLANS[plan], expected=_by_xla(case))
    assert not wrong, wrong


def test_sorting_stays_within_its_arrays():
    """Its last run is shorter than the others, along each axis."""
    x = _normal(5, 11)
    assert not differences(lambda x: [jnp.sort(x, i) for i in (0, 1, None)], x, plan=Options(1, 1), checked=True)


# --- frames in vectors ----------------------------------------------------------------------------------------------


def _frames(x, f, n):
    """x: (3,), f: (3, k), n: 2."""
    k = f.shape[1]
    g = jnp.sin(f)
    a = jnp.outer(x, x)
    step = lambda c, i: (jnp.where(i % 2 == 0, c * 0.9, c[::-1]) + jnp.cos(c), (c[0], c.sum(), c))  # noqa: E731
    return {
        "entrywise": g * f + x[:, None] - jnp.maximum(f, 0.1),
        "with a row": f * jnp.arange(k * 1.0)[None],
        "compared": (f > g) & (f < 1),
        "select": jnp.where(f > 0, f, g),
        "select of one": jnp.where(n > 1, f, g),
        "rows": (f[0], f[1:], f[::2], f[n], f[::-1]),
        "columns": (f[:, 0], f[:, 1:], f[:, ::-1], f[:, n % k]),
        "corner": f[1:, 1:],
        "integers": (f * 10).astype(int) % 3,
        "float32": f.astype(np.float32) * 2,
        "division": f / x[:, None] ** 2,
        "stack": jnp.stack([f[0], g[1], f[0] * g[2]]),
        "stack 1": jnp.stack([x] * k, 1) + f,
        "unstack": [r * 2 for r in f],
        "concatenate": jnp.concatenate([f[1:], g[:1], f]),
        "concatenate 1": jnp.concatenate([f[:, :1], g], 1),
        "split": jnp.split(f, [1]),
        "pad": (jnp.pad(f, ((1, 1), (0, 0))), jnp.pad(f, ((0, 0), (1, 0)))),
        "diagonal": jnp.diag(jnp.exp(f[0])) + g.T @ f,
        "dot": a @ f,
        "from the right": f @ jnp.ones((k, 2)),
        "square": f.T @ f,
        "vector": x @ f,
        "back": f @ f[0],
        "both": jnp.einsum("ij,kl->ikjl", a, f),
        "with itself": jnp.einsum("ik,ik->k", f, g),
        "tensor": jnp.einsum("ij,jk,i->k", a, f, x),
        "of several": jnp.einsum("aij,i->aj", jnp.stack([f, g]), x),
        "sums": (f.sum(), f.sum(0), f.sum(1)),
        "extrema": (f.max(0), f.min(1), f.prod(0), jnp.argmax(f, 0)),
        "any": (f > 0).any(0),
        "cumsum": (jnp.cumsum(f, 0), jnp.cumsum(f, 1)),
        "greatest": (lax.top_k(f, 2), lax.top_k(jnp.abs(jnp.round(f)), 2)),
        "sort": (jnp.sort(f, 0), jnp.sort(f, 1)),
        "transpose": (f.T, f.T * f.T),
        "reshape": (f.reshape(-1), f.reshape(k, 3), f[None], f[:, None], f[:, :, None]),
        "roll": (jnp.roll(f, 1, 0), jnp.roll(f, 1, 1)),
        "broadcast": jnp.broadcast_to(f[:, None], (3, 2, k)) * 2,
        "repeated": (lax.broadcast(f, (2,)), lax.broadcast_in_dim(f, (3, k, k), (0, 1))),
        "permuted": jnp.transpose(jnp.stack([f, g]), (1, 0, 2)),
        "unstacked": (jnp.unstack(f), jnp.unstack(f, axis=1)),
        "norms": f / jnp.sqrt((f * f).sum(0))[None],
        "known": jnp.eye(3, k) + f,
        "only known": jnp.eye(3, k) * 2 + 1,
        "ones": jnp.ones((3, k)) @ f.T,
        "put": (f.at[n].set(g[0]), f.at[:, 1].add(x), f.at[1, n % k].set(5.0)),
        "slice": lax.dynamic_slice(f, (n, 0), (1, k)),
        "update": lax.dynamic_update_slice(f, g[:1], (n, 0)),
        "power": (f**2, f**-3, jnp.abs(f) ** 0.5, jnp.tanh(f)),
        "scan": lax.scan(step, f, jnp.arange(9)),
        "short scan": lax.scan(step, f, jnp.arange(3)),
        "over rows": lax.scan(lambda c, r: (c + r, c * r), f[0], f),
        "while": lax.while_loop(lambda c: c[0] < n + 3, lambda c: (c[0] + 1, c[2], c[1] + a @ c[2]), (0, f, g)),
        "known start": lax.fori_loop(0, n, lambda i, c: c + f, jnp.zeros((3, k))),
        "cond": lax.cond(n == 2, lambda a, b: (a, b[0]), lambda a, b: (b, a[1]), f, g),
        "switch": lax.switch(n, [lambda a: a, lambda a: a * 0 + 1, lambda a: a[::-1]], f),
        "jit": jax.jit(lambda a: (a, a + 1))(f),
        "barrier": lax.optimization_barrier((f, g)),
        "mixed cond": lax.cond(n == 1, lambda: jnp.ones((3, k)), lambda: f),
        "jvp": jax.vmap(lambda v: jax.jvp(lambda x: jnp.sin(x) * x[::-1], (x,), (v,))[1], 1, 1)(f),
        "triangle": lax.fori_loop(0, 3, lambda i, c: c.at[i].set(c[i] - c[i] @ c.T @ c * 0.1), f),
        "constants": (f * np.arange(3.0 * k).reshape(3, k)),
    }


def _frames_in_a_loop(x, f, n):
    """The same in the only turn of a loop, in whose state rows are vectors (unless it returns them as they are)."""
    shapes = jax.eval_shape(_frames, x, f, n)
    start = jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), shapes)
    return lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + n, -c[1], _frames(x, c[1], n)), (0, f, start))[2]


@pytest.mark.slow
@pytest.mark.parametrize("columns", [2, 3, 4, 8])
def test_frames_in_vectors(columns):
    operands = _normal(3), _normal(3, columns), 2
    expected = jax.jit(_frames)(*operands)
    wrong = differences(_frames_in_a_loop, *operands, columns=columns, plan=Options(32, 2), expected=expected)
    wrong |= differences(_frames, *operands, columns=columns, plan=Options(4, 1), expected=expected)
    assert not wrong, wrong


# --- lanes -----------------------------------------------------------------------------------------------------------


def _lanes(x, n, p):
    """x: (3,), n: an integer, p: a number; x and n differ among lanes, p does not."""
    y = jnp.sin(x) * p
    halve = lambda c: (c[0] + 1, jnp.where(c[0] % 2 == 0, c[1] * 0.5, c[1] + c[2]), c[1])  # noqa: E731
    inner = lambda c: (c[0] + 1, lax.scan(lambda a, b: (a * 0.9 + b, a[0]), c[1], x)[0])  # noqa: E731
    long = lambda c: (c[0] + 1, lax.fori_loop(0, 7, lambda i, a: a * 0.9 + i, c[1]))  # noqa: E731
    return {
        "entrywise": y * x - jnp.maximum(y, 0.1),
        "shared": jnp.cos(p),
        "known": jnp.arange(3),
        "compared": (x > y, n > 2),
        "library": (jnp.tanh(x), jnp.exp(y)),
        "integers": (n // 3, n % 3, n << 2, n.astype(float)),
        "moves": (x[::-1], jnp.roll(x, n)),
        "index": (x[n], x[n % 3], x.at[n].set(1.0), lax.dynamic_slice(x, (n,), (2,))),
        "sort": (jnp.sort(x), jnp.argsort(x)),
        "reductions": (x.sum(), jnp.argmax(x), jnp.cumsum(x)),
        "dot": jnp.outer(x, y) @ x,
        "select": jnp.where(n > 2, x, y),
        "while": lax.while_loop(lambda c: c[0] < n, halve, (0, x, y)),
        "same": lax.while_loop(lambda c: c[0] < 4, halve, (0, x, y)),
        "until": lax.while_loop(lambda c: jnp.abs(c[1]).max() > 0.1, lambda c: (c[0] + 1, c[1] * 0.7), (n, x)),
        "grows": lax.while_loop(lambda c: c[0] < 3, lambda c: (c[0] + 1, c[2], c[1] + n), (0, 0, 1)),
        "nested": lax.while_loop(lambda c: c[0] < n, inner, (0, x)),
        "nested long": lax.while_loop(lambda c: c[0] < n, long, (0, x)),
        "triangle": lax.while_loop(
            lambda c: c[0] < n,
            lambda c: (c[0] + 1, lax.while_loop(lambda d: d[0] < c[0], lambda d: (d[0] + 1, d[1] + 1), (0, c[1]))[1]),
            (0, 0),
        ),
        "scan": lax.scan(lambda c, i: (c * 0.9 + x, (c.sum(), c)), x, jnp.arange(20)),
        "short": lax.scan(lambda c, i: (c + i, c), n, jnp.arange(3)),
        "back": lax.scan(lambda c, i: (c + i, c), n, jnp.arange(30), reverse=True),
        "cond": lax.cond(n > 2, lambda a, b: (a, b), lambda a, b: (b, -a), x, y),
        "switch": lax.switch(n - 1, [lambda a: a, lambda a: a * 2, lambda a: a[::-1]], x),
        "shared cond": lax.cond(p > 1, lambda a: a, lambda a: a * 2, x),
        "loop in cond": lax.cond(
            n > 2,
            lambda a: lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1] * 0.5), (0, a))[1],
            lambda a: lax.fori_loop(0, 9, lambda i, c: c + i, a),
            x,
        ),
        "side by side": jax.vmap(
            lambda m, y: lax.while_loop(lambda c: c[0] < m, lambda c: (c[0] + 1, c[1] * 0.5 + x), (n, y)), (0, None)
        )(jnp.arange(4), x),
        "cond in loop": lax.fori_loop(0, 5, lambda i, c: lax.cond(i < n, lambda c: c + 1, lambda c: c * 2, c), x),
        "fixed": lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1], c[2] + c[1]), (0, x, y)),
        "shared at the end": lax.while_loop(lambda c: c[0] < 3, lambda c: (c[0] + 1, c[2], p, 1), (0, x[0], x[1], n)),
        "summed records": lax.scan(lambda c, i: (c * 0.9 + x, c), x, jnp.arange(20))[1].sum(0),
    }


def _lanes_of_many(x, n, p):
    """As above, with more entries than are held as such."""
    y = jnp.sin(x) * p
    m = jnp.outer(x, y)
    return {
        "entrywise": y * x,
        "moves": (x[::-1], m.T, m[1:], jnp.concatenate([x, y]), jnp.stack([x, y])),
        "sums": (x.sum(), m.sum(0), m.max(1)),
        "cumsum": jnp.cumsum(x),
        "argmax": jnp.argmax(x),
        "dot": m @ x,
        "shared": jnp.arange(6) * 2,
        "put": x.at[2].set(n.astype(float)),
        "scan": lax.scan(lambda c, a: (c.at[0].add(a) + x[::-1] * 0.1, c), y, x),
        "loop": lax.fori_loop(0, 9, lambda i, c: (c[1], c[0].at[i % 6].add(p)), (x, y)),
        "cond": lax.cond(n > 2, lambda a: (a.at[1].set(0.0), a), lambda a: (a * 2, a[::-1]), y),
        "shared cond": lax.cond(p > 1, lambda a: a, lambda a: np.ones(6), x),
        "same while": lax.while_loop(
            lambda c: c[0] < p * 5, lambda c: (c[0] + 1, c[1] * 0.5 + n.astype(float)), (0.0, y)
        ),
        "kept": y,
        "all": (x > 0).all(),
        "conditions": x > 0.5,
        "select": jnp.where(n > 2, x, y),
        "constants": x + np.arange(6.0),
        "index": (x[n], m[n % 3], lax.dynamic_slice(m, (n % 6, 1), (1, 5)), jnp.arange(9.0)[n], x[n - 9]),
        "put anywhere": (x.at[n].set(1.0), x.at[n % 6].add(p), lax.dynamic_update_slice(x, y[:5], (n,))),
        "until": lax.fori_loop(0, n, lambda i, c: c.at[i % 6].add(1.0), x),
        "change places": lax.fori_loop(0, n, lambda i, c: (c[1] * 0.5, c[0]), (x, y)),
        "hand on": lax.fori_loop(0, n, lambda i, c: (c[0], c[0] + c[1] * 0.5), (x, y)),
        "put in a branch": lax.cond(
            n > 2, lambda a: a.at[n].set(0.0).at[0].add(n.astype(float)), lambda a: a.at[n].add(1.0), y
        ),
        "loop in a branch": lax.cond(
            n > 2,
            lambda a: lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1].at[c[0]].set(0.5)), (0, a))[1],
            lambda a: lax.fori_loop(0, 3, lambda i, c: c.at[i].multiply(2.0) + c[n], a),
            x,
        ),
        "nobody's branch": lax.cond(n > 99, lambda a: lax.fori_loop(0, 9, lambda i, c: c * 0.5, a), lambda a: a, x),
        "records": _recorded(x, n),
    }


def _recorded(x, n):
    """A loop that keeps something of each turn, as long as it goes on."""

    def turn(c):
        i, kept, x = c
        return i + 1, kept.at[i].set(x.sum()), lax.fori_loop(0, i % 3, lambda j, x: x.at[j].multiply(0.5), x)

    return lax.while_loop(lambda c: (c[0] < n) & (c[2][0] < 9), turn, (0, jnp.zeros(8), x))


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [2, 4])
@pytest.mark.parametrize(("function", "length", "small"), [(_lanes, 3, 16), (_lanes_of_many, 6, 4)])
def test_lanes(function, length, small, lanes):
    x, n, p = _normal(lanes, length), np.arange(lanes) * 2 + 1, np.float64(1.5)
    expected = jax.jit(jax.vmap(function, (0, 0, None)))(x, n, p)
    compiled = native.compile(function, x[0], n[0], p, lanes=lanes, wide=(True, True, False), plan=Options(small, 1))
    got = compiled(np.moveaxis(x, 0, -1), n, p)
    wrong = {
        jax.tree_util.keystr(path): how
        for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(expected), jax.tree.leaves(got), strict=True)
        if (how := difference(a, np.moveaxis(b, -1, 0))) is not None
    }
    assert not wrong, wrong
