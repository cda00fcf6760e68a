"""Factorisations, solves and large products against XLA's, which calls the same LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from lyaphybrid import native
from lyaphybrid.native._costs import Plan

PLANS = {"in-memory": Plan(1, 1), "entries": Plan(64, 1)}


def check(function, *operands, plan, rtol):
    found = native.compile(function, *operands, plan=plan)(*operands)
    wanted = jax.jit(function)(*operands)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype)
        np.testing.assert_allclose(
            ours, theirs, rtol=rtol, atol=rtol * max(1.0, float(np.max(np.abs(theirs), initial=0)))
        )


def positive(a):
    return a @ jnp.swapaxes(a, -1, -2) + jnp.broadcast_to(jnp.eye(a.shape[-1], dtype=a.dtype), a.shape)


PROGRAMS = [
    lambda a: jnp.linalg.cholesky(positive(a)),
    lambda a: jnp.linalg.qr(a),
    lambda a: jnp.linalg.qr(a[..., :, : a.shape[-1] // 2 + 1]),
    lambda a: jnp.linalg.qr(a[..., : a.shape[-1] // 2 + 1, :]),
    lambda a: jnp.linalg.qr(a[..., :, : a.shape[-1] // 2 + 1], mode="complete"),
    lambda a: jnp.linalg.eigh(positive(a))[0],
    lambda a: (lambda w, v: jnp.abs(v))(*jnp.linalg.eigh(positive(a), symmetrize_input=False)),
    lambda a: jnp.linalg.solve(positive(a), a),
    lambda a: jnp.linalg.inv(positive(a)),
    lambda a: jnp.linalg.slogdet(a),
    lambda a: lax.linalg.lu(a),
    lambda a: lax.linalg.lu(a[..., :2, :]),
    *(
        lambda a, left=left, lower=lower, turned=turned, unit=unit: lax.linalg.triangular_solve(
            positive(a), a, left_side=left, lower=lower, transpose_a=turned, unit_diagonal=unit
        )
        for left, lower, turned, unit in [(1, 1, 0, 0), (1, 0, 0, 0), (0, 1, 1, 0), (0, 0, 0, 1), (1, 1, 1, 1)]
    ),
]


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (2, 4, 4), (40, 40)], ids=str)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("plan", PLANS)
def test_factorisations_and_solves(shape, dtype, plan):
    a = jnp.asarray(np.random.default_rng(0).normal(size=shape).astype(dtype) / np.sqrt(shape[-1]))
    programs = PROGRAMS if shape[-1] > 1 else PROGRAMS[:11]
    check(lambda a: [f(a) for f in programs], a, plan=PLANS[plan], rtol=1e-11 if dtype == "float64" else 3e-3)


@pytest.mark.parametrize("plan", PLANS)
def test_what_cannot_be_factorised(plan):
    bad = jnp.asarray([[[1.0, 2.0], [2.0, 1.0]], [[4.0, 0.0], [0.0, 9.0]]])
    found = native.compile(jnp.linalg.cholesky, bad, plan=PLANS[plan])(bad)
    np.testing.assert_array_equal(found, jnp.linalg.cholesky(bad))
    assert np.all(np.isnan(found[0][1]))
    assert not np.any(np.isnan(found[1]))
    singular = jnp.zeros((2, 2))
    check(lambda a: lax.linalg.lu(a), singular, plan=PLANS[plan], rtol=1e-15)
    unknown = jnp.full((3, 3), jnp.nan)
    check(jnp.linalg.eigh, unknown, plan=PLANS[plan], rtol=1e-15)


@pytest.mark.parametrize("plan", PLANS)
def test_within_loops_branches_and_derivatives(plan):
    a = jnp.asarray(np.random.default_rng(1).normal(size=(5, 5)))

    def frames(a):
        def step(q, _):
            q, r = jnp.linalg.qr(a @ q)
            return lax.cond(r[0, 0] > 0, lambda q: q, lambda q: -q, q), jnp.log(jnp.abs(jnp.diagonal(r)))

        return lax.scan(step, jnp.eye(5), length=7)

    check(frames, a, plan=PLANS[plan], rtol=1e-11)
    check(jax.jacfwd(lambda a: jnp.linalg.solve(positive(a), a[0])), a, plan=PLANS[plan], rtol=1e-11)
    check(jax.grad(lambda a: jnp.sum(jnp.linalg.cholesky(positive(a)))), a, plan=PLANS[plan], rtol=1e-11)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_large_products_go_to_blas(dtype):
    a = jnp.asarray(np.random.default_rng(2).normal(size=(40, 50)).astype(dtype))
    function = lambda a: [a @ a.T, a.T @ a, jnp.einsum("ij,kj->ik", a, a), jnp.einsum("ji,jk->ik", a, a), a @ a.T @ a]  # noqa: E731
    check(function, a, plan=Plan(16, 1), rtol=1e-12 if dtype == "float64" else 1e-5)
    closed = jax.make_jaxpr(function)(a)
    assert native.Compiled(closed, plan=Plan(16, 1)).text.count("call void @scipy_") == 6


def test_what_lapack_does_not_take():
    with pytest.raises(native.Unsupported, match="qr with pivoting|the primitive"):
        native.compile(lambda a: jax.scipy.linalg.qr(a, pivoting=True), jnp.eye(3))
