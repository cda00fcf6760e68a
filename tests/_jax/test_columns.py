"""A linear function of all columns at once, against the same function column by column."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from examples import primitives
from lyaphybrid._jax.columns import MIXED, OF_FIRST, each_column
from many_derivatives import wrong_linear
from random_programs import random_program

N, K = 6, 4
FRAME = np.random.default_rng(0).normal(size=(N, K))
MATRIX = np.random.default_rng(1).normal(size=(N, N))
BLOCKS = np.random.default_rng(2).normal(size=(2, 3, 3))
WHICH, FAR = jnp.asarray(2), jnp.asarray(-2 - N)  # counted from the end: −2, which is the first place


def _along(function, dx):
    return jax.jvp(function, (jnp.asarray(MATRIX[0]),), (dx,))[1]


def _matrix_of_branch(x):
    return lax.cond(x[0] > 0, lambda x: jnp.outer(x, x), lambda x: jnp.eye(N), x)


def _matrix_of_scan(x):
    return lax.scan(lambda matrix, i: (matrix / 2 + i * jnp.outer(x, x), matrix.sum()), jnp.eye(N), jnp.arange(3.0))[0]


def _matrix_of_while(x):
    def body(state):
        matrix, other, i = state
        return matrix / 2 + jnp.diag(other), jnp.roll(x, 1), i + 1

    return lax.while_loop(lambda state: state[2] < 3, body, (jnp.eye(N), jnp.ones(N), 0))[0]


def _replaced_where_a_branch_says(x):
    where, new = lax.cond(x[1] > 0, lambda x: (1, x * x), lambda x: (2, x), x)
    return lax.dynamic_update_slice(x, new[:2], (where,))


# What the equations of a jaxpr may be, each as a linear function of dx (N,).
LINEAR = {
    "entry by entry": lambda dx: jnp.where(jnp.arange(N) > 2, -2.0 * dx, dx / 3 + (dx - MATRIX[0] * dx)),
    "a scalar choice": lambda dx: lax.select(WHICH > 1, dx, 2 * dx),
    "a sum of two uses": lambda dx: jax.linear_transpose(lambda x: (-x, x), dx)((dx, 2 * dx))[0],
    "components": lambda dx: jnp.stack([dx[1], dx[0] - dx[2], 3.0 * dx[5]]),
    "slices": lambda dx: jnp.concatenate([dx[3:], 0 * dx[:1], lax.slice(dx, (0,), (6,), (2,))]),
    "neighbours": lambda dx: jnp.roll(dx, 1) - jnp.roll(dx, -2),
    "a part replaced": lambda dx: lax.dynamic_update_slice(dx, 2 * dx[:2], (WHICH,)),
    "a part of a constant replaced": lambda dx: lax.dynamic_update_slice(jnp.ones(N) * 0, dx[:2], (WHICH,)),
    "a place far outside": lambda dx: lax.dynamic_update_slice(dx[::-1], 2 * dx[:2], (FAR,)),
    "some from far outside": lambda dx: lax.dynamic_slice_in_dim(dx, FAR, 3),
    "one of many": lambda dx: lax.dynamic_slice_in_dim(dx, WHICH, 3),
    "an index": lambda dx: dx[WHICH],
    "a list of indices": lambda dx: dx[jnp.array([3, 1, 1])],
    "an entry set": lambda dx: dx.at[1].set(2 * dx[0]),
    "padding": lambda dx: jnp.pad(dx[:3], (1, 2)),
    "padding with a number of its own": lambda dx: lax.pad(jnp.zeros(2), dx[0], [(1, 1, 0)]),
    "matrix times column": lambda dx: jnp.asarray(MATRIX) @ dx,
    "column times matrix": lambda dx: dx @ jnp.asarray(MATRIX),
    "matrices, column left": lambda dx: jnp.tensordot(dx.reshape(2, 3), jnp.asarray(BLOCKS), ((1,), (1,))),
    "a batch of blocks": lambda dx: jnp.einsum("bij,bj->bi", jnp.asarray(BLOCKS), dx.reshape(2, 3)),
    "a batch, column left": lambda dx: jnp.einsum("bj,bji->bi", dx.reshape(2, 3), jnp.asarray(BLOCKS)),
    "an outer product": lambda dx: jnp.outer(dx, jnp.arange(3.0)),
    "axes": lambda dx: dx.reshape(2, 3).T.sum(axis=0),
    "axes that a reshape turns": lambda dx: lax.reshape(dx.reshape(2, 3), (6,), (1, 0)),
    "everything": jnp.sum,
    "running sums": jnp.cumsum,
    "the same for all columns": lambda dx: jnp.zeros(2),
    "a tree": lambda dx: {"half": dx / 2, "pair": (dx[0], jnp.ones(2) * 0)},
    "single precision": lambda dx: dx.astype(jnp.float32),
    "inside a jit": jax.jit(lambda dx: 2 * dx),
    "a conditional": lambda dx: lax.cond(WHICH > 1, lambda dx: 2 * dx[::-1], lambda dx: 0 * dx, dx),
    "a conditional with a constant branch": lambda dx: lax.cond(WHICH < 1, lambda dx: dx, lambda dx: jnp.zeros(N), dx),
    "a product with a matrix of a branch": jax.jit(lambda dx: _along(lambda x: _matrix_of_branch(x) @ x, dx)),
    "a product with a matrix of a loop": lambda dx: _along(lambda x: _matrix_of_scan(x) @ x, dx),
    "a product with a matrix of a loop that ends": lambda dx: _along(lambda x: _matrix_of_while(x) @ x, dx),
    "a part whose place a branch chooses": lambda dx: _along(_replaced_where_a_branch_says, dx),
    "a loop": lambda dx: lax.fori_loop(0, 3, lambda i, dx: jnp.roll(dx, 1) * (i + 1), dx),
    "the derivative of products": lambda dx: _along(lambda x: jnp.prod(jnp.outer(x, x), axis=1), dx),
    "a derivative": lambda dx: jax.jvp(lambda x: jnp.sin(x) * x[0], (jnp.arange(6.0),), (dx,))[1],
}


@pytest.mark.parametrize("name", LINEAR)
def test_as_column_by_column(name):
    frame = jnp.asarray(FRAME)
    apart = [LINEAR[name](frame[:, j]) for j in range(K)]
    together = each_column(LINEAR[name], frame)
    expected = jax.tree.map(lambda *parts: jnp.stack(parts, axis=-1), *apart)
    assert jax.tree.structure(together) == jax.tree.structure(expected)
    for got, wanted in zip(jax.tree.leaves(together), jax.tree.leaves(expected), strict=True):
        assert got.shape == wanted.shape
        assert got.dtype == wanted.dtype
        np.testing.assert_allclose(got, wanted, rtol=1e-6 if got.dtype == jnp.float32 else 1e-13, atol=1e-13)


@pytest.mark.parametrize("name", LINEAR)
def test_no_column_at_all(name):
    found = each_column(LINEAR[name], jnp.zeros((N, 0)))
    expected = jax.tree.map(lambda leaf: (*leaf.shape, 0), jax.eval_shape(LINEAR[name], jnp.zeros(N)))
    assert jax.tree.map(lambda leaf: leaf.shape, found) == expected


def test_every_rule_is_used_above():
    used = set()
    for function in LINEAR.values():
        used |= primitives(jax.make_jaxpr(function)(jnp.zeros(N)).eqns)
    assert {*MIXED, *OF_FIRST} - used <= {"stack"}  # a primitive in newer versions of JAX only


@pytest.mark.slow
def test_random_programs():
    """All columns, the magnitudes of their terms and what each entry depends on, for derivatives of random programs."""

    @settings(max_examples=40)
    @given(st.data())
    def agree(data):
        program, operands = random_program(lambda n: data.draw(st.integers(0, n - 1)))
        assert not wrong_linear(program, operands)

    agree()


@pytest.mark.parametrize("name", ["neighbours", "slices", "a part replaced", "an index"])
def test_no_transposition(name):
    traced = jax.make_jaxpr(lambda frame: each_column(LINEAR[name], frame))(FRAME)
    vmapped = jax.make_jaxpr(jax.vmap(LINEAR[name], -1, -1))(FRAME)
    assert "transpose" not in primitives(traced.eqns)
    assert "transpose" in primitives(vmapped.eqns)


@pytest.mark.slow
def test_under_transformations():
    def doubled(scale, frame):
        return each_column(lambda dx: lax.cond(scale > 0, lambda dx: scale * dx[::-1], lambda dx: dx, dx), frame)

    frame, scales = jnp.asarray(FRAME), jnp.array([-1.0, 2.0])
    lanes = jax.jit(jax.vmap(doubled, (0, None)))(scales, frame)
    np.testing.assert_array_equal(lanes, jnp.stack([frame, 2 * frame[::-1]]))
    slope = jax.jvp(lambda scale: doubled(scale, frame), (2.0,), (1.0,))[1]
    np.testing.assert_array_equal(slope, frame[::-1])
