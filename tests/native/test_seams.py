"""Concatenations along the first axis that stay lazy: neighbours in a ring, and all that may be done with them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options
from lyaphybrid.native.lowering.lowering import lower
from lyaphybrid.native.lowering.seams import MOST_SEAMS, Spans, cut, united, within

VECTOR, FRAME = np.sin(np.arange(40.0)), np.cos(np.arange(120.0)).reshape(40, 3)


def many(x):
    """More pieces than a loop is cut into."""
    return jnp.concatenate([x[i : i + 3] for i in range(3 * MOST_SEAMS + 3, -1, -3)])


def turned(x):
    """A state that a loop overwrites while its neighbours are read."""
    return lax.fori_loop(0, 5, lambda i, x: x + 0.1 * (jnp.roll(x, 1) - jnp.roll(x, -2)), x)


CASES = {
    "a ring": lambda x, v: jnp.roll(x, -1) * jnp.roll(x, 2) - x,
    "a frame": lambda x, v: jnp.roll(x, 1)[:, None] * jnp.roll(v, -1, 0) - (x - jnp.roll(x, 2))[:, None] * v,
    "a neighbour's neighbour": lambda x, v: jnp.roll(jnp.roll(x, 1), 1) + jnp.roll(x[5:30], 3)[4:].sum() + x,
    "of what is computed": lambda x, v: jnp.roll(x * x, 1) + jnp.roll(jnp.exp(x), 3),
    "many pieces": lambda x, v: (many(x), many(x) + x[: 3 * MOST_SEAMS + 6], many(v) * 2.0),
    "ends": lambda x, v: jnp.concatenate([jnp.array([7.0]), x[:-2], jnp.array([8.0])]) - x,
    "a few numbers beside many": lambda x, v: jnp.concatenate([x[:5], x[:35] * 2.0]) * x,
    "two frames": lambda x, v: jnp.concatenate([v, v[:1], v[::-1]]),
    "at places": lambda x, v: (jnp.roll(x, 3)[np.array([0, 3, 39])], lax.dynamic_slice(jnp.roll(x, 3), (2,), (30,))),
    "sums and products": lambda x, v: (jnp.roll(x, 3).sum(), jnp.roll(x, 3) @ v, jnp.cumsum(jnp.roll(x, 3))),
    "moved about": lambda x, v: [f(jnp.roll(v, 3, 0)) for f in (jnp.transpose, jnp.flip, lambda v: v[1::2])],
    "stacked": lambda x, v: (jnp.stack([jnp.roll(x, 3), x]), jnp.stack([jnp.roll(x, 3), x], axis=1)),
    "reshaped": lambda x, v: (jnp.roll(x, 3).reshape(8, 5), jnp.roll(x, 3)[:, None] + v, jnp.roll(v, 3, 0).ravel()),
    "sines": lambda x, v: jnp.sin(jnp.roll(x, 1) - x) + jnp.cos(jnp.roll(x, -1)),
    "along the other axis": lambda x, v: jnp.roll(v, 1, 1) - v,
    "a branch": lambda x, v: lax.cond(x[0] > 0.5, lambda y: y, lambda y: -y, jnp.roll(x, 1)) * x,
    "a choice": lambda x, v: jnp.where(x > 0, jnp.roll(x, 1), x),
    "in a loop": lambda x, v: (turned(x), turned(v)),
    "a derivative": lambda x, v: jax.jacfwd(lambda x: jnp.roll(x, 1) * x)(x) @ v,
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("plan", [Options(1, 1), Options(8, 2)], ids=["in memory", "mixed"])
def test_as_xla_has_it(case, plan):
    found = native.compile(CASES[case], VECTOR, FRAME, plan=plan)(VECTOR, FRAME)
    wanted = jax.jit(CASES[case])(VECTOR, FRAME)
    jax.tree.map(lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13), found, wanted)


def test_many_runs_in_parallel():
    starts = VECTOR[:, None] + np.arange(8.0)
    run = lambda x: jnp.concatenate([CASES["a ring"](x, None), CASES["sines"](x, None), turned(x)])  # noqa: E731
    (found,) = native.Compiled(jax.make_jaxpr(run)(VECTOR), lanes=8, wide=(True,), plan=Options(8, 1))(starts)
    np.testing.assert_allclose(found, jax.vmap(run, -1, -1)(starts), rtol=1e-12, atol=1e-12)


def loops_of(function) -> tuple[int, int]:
    """Arrays in memory besides operands and result, and loops."""
    text = lower(jax.make_jaxpr(function)(VECTOR, FRAME), 1)
    return text.count("alloca"), text.count("phi i64")


def test_neighbours_are_not_written_and_loops_are_cut_where_they_begin():
    assert loops_of(lambda x, v: jnp.roll(x, 1) - x) == (0, 1)  # element 0, and one loop for the others
    assert loops_of(lambda x, v: jnp.roll(x, 3) - x) == (0, 2)
    assert loops_of(lambda x, v: jnp.roll(x, 3) - jnp.roll(x, -3) * x) == (0, 3)
    assert loops_of(lambda x, v: jnp.roll(v, 3, 0) * jnp.roll(x, -3)[:, None]) == (0, 6)


def test_what_has_too_many_pieces_or_a_costly_one_is_written():
    assert loops_of(lambda x, v: many(x) - 1.0)[0] == 1
    assert loops_of(lambda x, v: jnp.roll(jnp.exp(x), 3) - x)[0] >= 1


def test_loops_that_are_not_cut_read_from_memory():
    """They would select among all pieces for each element."""
    for function in (
        lambda x, v: jnp.sum(jnp.roll(x, 3) * x),
        lambda x, v: (jnp.roll(x, 3) - x) @ v,
        lambda x, v: jnp.flip(jnp.roll(x, 3)),
        lambda x, v: jnp.stack([jnp.roll(x, 3), x]),
        lambda x, v: jnp.stack([jnp.roll(x, 3), x], axis=1),
    ):
        assert "select i1" not in lower(jax.make_jaxpr(function)(VECTOR, FRAME), 1)


def test_seams():
    assert cut(10, (2, 7)) == [(0, 2), (2, 7), (7, 10)]
    assert cut(10, ()) == [(0, 10)]
    assert united([(1, 5), (), (5, 7)]) == (1, 5, 7)
    assert within((1, 5, 7), 1, 6) == (4,)  # the ends of a part are no seams of it


def test_spans():
    spans = Spans()
    spans.note("%i", 0, 10)
    spans.shift("%j", 3, "%i")
    spans.shift("%k", "%i", "%j")
    assert spans.inside("%j", 3, 13)
    assert not spans.inside("%j", 4, 13)
    assert not spans.inside("%j", 3, 12)
    assert not spans.inside("%k", 0, 100)  # known only at run time
    assert spans.inside(5, 5, 6)
    assert not spans.inside(6, 5, 6)
