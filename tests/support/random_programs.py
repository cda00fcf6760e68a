"""Random programs: nested loops and branches, arrays written in place, gathers, reductions, on floats and integers.

Floats stay within ±2 or so and no step multiplies differences by much, so that rounding stays small; whatever is
discrete (conditions, indices, orders) comes from integers, which are exact.
"""

# ruff: noqa: E501  tables of programs

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

SIZES = (2, 3, 5, 12, 30)
_MODES = ("clip", "fill", "drop")


def _is_float(x) -> bool:
    return x.dtype == np.float64


class Writer:
    """Writes a program while JAX traces it; `choose(n)` is the one source of chance: a number below n."""

    def __init__(self, choose: Callable[[int], int]):
        self.choose = choose

    def pick(self, options: Sequence):
        """One of several; the last ones more often."""
        n = len(options)
        return options[max(self.choose(n), self.choose(n))]

    def among(self, pool: list, test: Callable):
        """A value of the pool that passes a test, or None."""
        fitting = [x for x in pool if test(x)]
        return self.pick(fitting) if fitting else None

    def like(self, pool: list, x):
        """A value of the pool of the same type and shape."""
        return self.among(pool, lambda y: y.shape == x.shape and y.dtype == x.dtype)

    def integer(self, pool: list):
        """An integer, in bounds or out of them."""
        x = self.among(pool, lambda y: y.shape == () and not _is_float(y))
        return x * (1, -1, 2, 1)[self.choose(4)] if x is not None else jnp.int64(self.choose(40) - 5)

    def floats(self, pool: list, ndim: int | None = None):
        """A float array."""
        return self.among(pool, lambda y: _is_float(y) and (y.ndim > 0 if ndim is None else y.ndim == ndim))

    def program(self, pool: list, length: int, depth: int) -> list:
        """Add values to the pool."""
        for _ in range(length):
            steps = (*_STEPS, *_CONTROL) if depth else _STEPS
            found = steps[self.choose(len(steps))](self, pool, depth)
            if found is not None:
                pool.extend(found if isinstance(found, list) else [found])
        return pool

    def results(self, pool: list, avals: Sequence) -> list:
        """Values of these types and shapes."""
        found = [self.like(pool, x) for x in avals]
        return [jnp.zeros(x.shape, x.dtype) if y is None else y for x, y in zip(avals, found, strict=True)]


# --- steps: (writer, pool, depth) -> a new value, several of them, or None where nothing fits ------------------------


def _one(w, pool, _):
    x = w.pick(pool)
    if not _is_float(x):
        return (x * 3 + 1) % 101 if w.choose(2) else ~x & 255
    return (
        jnp.sin(x), jnp.tanh(x), 1 - x * x * 0.5, jnp.exp(-x * x), jnp.abs(x), jnp.sqrt(1 + x * x) - 1, x / 2, -x, x + 0.25,
    )[w.choose(9)]  # fmt: skip


def _two(w, pool, _):
    x = w.pick(pool)
    y = w.like(pool, x)
    if not _is_float(x):
        return ((x + y * 7) % 103, x ^ y, jnp.maximum(x, y), x - jnp.minimum(y, 50), (x * y) % 97, x // (y % 5 + 1))[
            w.choose(6)
        ]
    return (
        (x + y) * 0.5, jnp.sin(x * y), jnp.maximum(x, y), x / (2 + y * y), x - y * 0.5, jnp.arctan2(x, 1 + y * y), jnp.cos(x - y),
    )[w.choose(7)]  # fmt: skip


def _select(w, pool, _):
    x = w.pick(pool)
    mask = w.among(pool, lambda y: y.shape in ((), x.shape) and not _is_float(y))
    if mask is None:
        return None
    condition = mask % 3 == 1
    return jnp.where(condition if condition.shape else jnp.broadcast_to(condition, x.shape), x, w.like(pool, x))


def _to_float(w, pool, _):
    x = w.among(pool, lambda y: not _is_float(y))
    return None if x is None else (x % 11).astype(np.float64) * 0.1


def _move(w, pool, _):
    x = w.among(pool, lambda y: y.ndim > 0)
    if x is None:
        return None
    axis = w.choose(x.ndim)
    n = x.shape[axis]
    cut = w.choose(n)
    kind = w.choose(8)
    if kind == 0:
        return jnp.flip(x, axis)
    if kind == 1:
        return x.T
    if kind == 2:
        return x.reshape(-1)
    if kind == 3:
        return jnp.concatenate([lax.slice_in_dim(x, cut, n, axis=axis), lax.slice_in_dim(x, 0, cut, axis=axis)], axis)
    if kind == 4:
        return lax.index_in_dim(x, cut, axis, keepdims=False)
    if kind == 5:
        zero = jnp.zeros((), x.dtype)
        return lax.pad(x, zero, [(cut, -cut, 0) if k == axis else (0, 0, 0) for k in range(x.ndim)])
    if kind == 6:
        y = w.like(pool, x)
        return jnp.stack([x, y], axis)[(slice(None),) * axis + (cut % 2,)]
    return lax.optimization_barrier((x, w.pick(pool)))[0]


def _broadcast(w, pool, _):
    x = w.among(pool, lambda y: y.ndim == 1)
    matrix = w.among(pool, lambda y: y.ndim == 2)
    if x is None or matrix is None:
        return None
    for axis in (0, 1):
        if matrix.shape[axis] == x.shape[0]:
            return lax.broadcast_in_dim(x, matrix.shape, (axis,))
    return None


def _reshape(w, pool, _):
    x = w.among(pool, lambda y: y.ndim > 0)
    to = None if x is None else w.among(pool, lambda y: y.size == x.size and y.shape != x.shape)
    return None if to is None else x.reshape(to.shape)


def _reduce(w, pool, _):
    x = w.among(pool, lambda y: y.ndim > 0)
    if x is None:
        return None
    axis, kind = w.choose(x.ndim), w.choose(6)
    n = x.shape[axis]
    if kind == 0:
        return jnp.sum(x, axis) / n if _is_float(x) else jnp.sum(x, axis) % 1009
    if kind == 1:
        return jnp.max(x) if w.choose(2) else jnp.min(x, axis)
    if kind == 2:
        return jnp.cumsum(x, axis) / n if _is_float(x) else lax.cumsum(x, axis, reverse=True) % 211
    if kind == 3:
        return jnp.sort(x, axis)
    if kind == 4:
        return None if _is_float(x) else jnp.argsort(x, axis)
    return jnp.sum(x * x) / x.size if _is_float(x) else jnp.argmax(x, axis)


def _dot(w, pool, _):
    x = w.floats(pool, 2)
    if x is None:
        v = w.floats(pool, 1)
        return None if v is None else jnp.dot(v, w.like(pool, v)) / v.size
    y = w.among(pool, lambda y: _is_float(y) and y.ndim > 0 and y.shape[0] == x.shape[1])
    return None if y is None else x @ y / x.shape[1]


def _indices(w, pool):
    return w.among(pool, lambda y: y.ndim == 1 and not _is_float(y))


def _gather(w, pool, _):
    x, i = w.among(pool, lambda y: y.ndim > 0), _indices(w, pool)
    if x is None:
        return None
    mode, fill = _MODES[w.choose(2)], 1
    kind = w.choose(3)
    if kind == 0 or i is None:
        return x.at[w.integer(pool)].get(mode=mode, fill_value=fill)
    if kind == 1:
        return x.at[i - 2].get(mode=mode, fill_value=fill)
    return x.at[..., i % (x.shape[-1] + 1)].get(mode=mode, fill_value=fill) if x.ndim > 1 else x[i % x.shape[0]]


def _put(w, pool, _):
    """In place, if nobody needs the old value."""
    x = w.among(pool, lambda y: y.ndim > 0)
    if x is None:
        return None
    mode, kind = _MODES[(0, 2)[w.choose(2)]], w.choose(5)
    part = w.among(pool, lambda y: y.shape == x.shape[1:] and y.dtype == x.dtype)
    part = jnp.ones(x.shape[1:], x.dtype) if part is None else part
    i = _indices(w, pool)
    if kind <= 1:
        return x.at[w.integer(pool)].set(part, mode=mode)
    if kind == 2 and i is not None:
        found = x.at[i - 1].add(jnp.broadcast_to(part, (i.size, *part.shape)), mode=mode)
        return found / i.size if _is_float(x) else found % 503
    if kind == 3 and i is not None:
        return x.at[i].max(part[None] if part.ndim else part, mode=mode)
    if kind == 4:
        smaller = w.among(
            pool, lambda y: y.ndim == x.ndim and y.dtype == x.dtype and all(np.less_equal(y.shape, x.shape))
        )
        return lax.dynamic_update_slice(x, smaller, [w.integer(pool) for _ in x.shape])
    return x.at[0].set(x[-1])


def _chain(w, pool, _):
    """Several writes to one array, and reads between them."""
    x = w.among(pool, lambda y: y.ndim == 1)
    if x is None:
        return None
    n, old = x.shape[0], x
    for _ in range(1 + w.choose(3)):
        x = x.at[w.choose(n)].set(x[w.choose(n)])
        if w.choose(3) == 0:
            pool.append(x)
    return [x, old[::-1]] if w.choose(2) else x


def _slice(w, pool, _):
    x = w.among(pool, lambda y: y.ndim > 0)
    if x is None:
        return None
    return lax.dynamic_slice(x, [w.integer(pool) for _ in x.shape], [1 + w.choose(n) for n in x.shape])


_STEPS = (
    _one, _one, _two, _two, _two, _select, _to_float, _move, _move, _broadcast, _reshape, _reduce, _dot, _gather, _put,
    _put, _chain, _slice,
)  # fmt: skip

# --- control flow ----------------------------------------------------------------------------------------------------


def _several(w, pool, most=4):
    return [w.pick(pool) for _ in range(1 + w.choose(most))]


def _body(w, outer, state, depth, avals=None):
    """The results of a few steps on a state; values of the outer program may be seen too."""
    seen = [x for x in outer if w.choose(4) == 0]
    inner = w.program([*seen, *state], 1 + w.choose(6), depth - 1)
    return w.results(inner, state if avals is None else avals)


def _scan(w, pool, depth):
    state, length = _several(w, pool), (0, 1, 2, 3, 5, 7)[w.choose(6)]
    x = w.among(pool, lambda y: y.ndim > 0)
    xs, records = [], _several(w, pool, 2)
    if x is not None and w.choose(3):
        length, xs = x.shape[0], [x] if w.choose(2) else [x, w.like(pool, x)]
    if w.choose(2):
        xs.append(jnp.arange(length))

    def body(state, now):
        found = _body(w, pool, [*state, *now], depth, [*state, *records])
        return found[: len(state)], found[len(state) :]

    state, ys = lax.scan(body, state, xs, length=length, reverse=bool(w.choose(2)))
    return [*state, *(y for y in ys if y.ndim <= 2 and y.size)]


def _while(w, pool, depth):
    state, limit = _several(w, pool), jnp.abs(w.integer(pool)) % 6

    def goes_on(state):
        return state[0] < limit

    def body(state):
        return [state[0] + 1, *_body(w, pool, state, depth)[1:]]

    return list(lax.while_loop(goes_on, body, [jnp.int64(w.choose(3)), *state]))


def _whiles_side_by_side(w, pool, depth):
    """Loops under vmap, of which each goes on as long as it wants."""
    x = w.among(pool, lambda y: y.ndim > 0)
    if x is None:
        return _while(w, pool, depth)
    state, limits = _several(w, pool, 2), jnp.arange(x.shape[0]) % (2 + w.choose(4))

    def body(state):
        return [state[0] + 1, *_body(w, [], state, depth)[1:]]

    def one(limit, part):
        return lax.while_loop(lambda now: now[0] < limit, body, [jnp.int64(w.choose(3)), part, *state])

    found = jax.vmap(one)(limits, x)
    return [y for y in found if y.ndim <= 2 and y.size]


def _branches(w, pool, depth):
    state, avals = _several(w, pool), _several(w, pool)
    branches = [lambda *state: _body(w, pool, list(state), depth, avals) for _ in range(2 + w.choose(3))]
    if len(branches) == 2:
        return list(lax.cond(w.integer(pool) % 2 == 0, *branches, *state))
    return list(lax.switch(w.integer(pool) % 5 - 1, branches, *state))


def _call(w, pool, depth):
    state, avals = _several(w, pool), _several(w, pool)
    return list(jax.jit(lambda *state: _body(w, pool, list(state), depth, avals))(*state))


_CONTROL = (_scan, _scan, _while, _while, _whiles_side_by_side, _branches, _branches, _call)


def random_program(choose: Callable[[int], int]):
    """A closed jaxpr, and operands for it."""
    w = Writer(choose)
    n, m, seed = SIZES[choose(len(SIZES))], SIZES[choose(3)], choose(1000)
    numbers = np.random.default_rng(seed)
    shapes = [(), (n,), (n,), (m,), (n, m), (m, n)]
    operands = [numbers.uniform(-1, 1, shape) for shape in shapes]
    operands += [numbers.integers(0, 40, shape) for shape in ((), (n,), (m,))]

    def function(*operands):
        pool = w.program(list(operands), 3 + choose((8, 8, 8, 30)[choose(4)]), 2)
        return [w.pick(pool) for _ in range(2 + choose(6))]

    return jax.make_jaxpr(function)(*operands), operands
