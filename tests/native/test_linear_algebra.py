"""The native compiler's linear algebra against XLA's: both call LAPACK."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options
from lyaphybrid.native.lowering.lowering import lower

PLANS = (Options(1, 2), Options(64, 0))
SIZES = (1, 2, 3, 5, 8, 9, 33, 70)


def all_agree(cases, **how):
    """Each (function, *operands) alone, against one program of XLA's for all of them."""
    functions, operands = [function for function, *_ in cases], [operands for _, *operands in cases]
    wanted = jax.jit(lambda given: [f(*some) for f, some in zip(functions, given, strict=True)])(operands)
    for function, some, expected in zip(functions, operands, wanted, strict=True):
        agree(function, *some, wanted=expected, **how)


def agree(function, *operands, plans=PLANS, tolerance=None, wanted=None):
    """Native and XLA's results are equal to rounding, nan where the other is nan."""
    expected = jax.tree.leaves(jax.jit(function)(*operands) if wanted is None else wanted)
    for plan in plans:
        found = jax.tree.leaves(native.compile(function, *operands, plan=plan, checked=True)(*operands))
        for x, y in zip(found, expected, strict=True):
            y = np.asarray(y)
            assert x.shape == y.shape
            assert x.dtype == y.dtype
            scale = np.max(np.abs(y), initial=1.0, where=np.isfinite(y))
            if y.dtype.kind == "f":
                limit = (tolerance or 200) * np.finfo(y.dtype).eps * scale
                np.testing.assert_allclose(x, y, rtol=0, atol=limit, err_msg=str(plan))
            else:
                np.testing.assert_array_equal(x, y, err_msg=str(plan))


def random(*shape, dtype=np.float64, seed=3):
    return np.random.default_rng(seed).standard_normal(shape).astype(dtype)


def positive(*shape, dtype=np.float64):
    x = random(*shape, dtype=dtype)
    return (x @ x.swapaxes(-1, -2) + shape[-1] * np.eye(shape[-1])).astype(dtype)


@pytest.mark.parametrize("n", SIZES)
def test_solve(n):
    solve, matrix = jnp.linalg.solve, random(n, n)
    all_agree([(solve, matrix, random(n, 2)), (solve, matrix, random(n))], tolerance=1e5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n", SIZES)
def test_cholesky(n, dtype):
    agree(jnp.linalg.cholesky, positive(n, n, dtype=dtype))


def test_cholesky_of_a_matrix_that_is_not_positive_is_nan():
    batch = np.stack([positive(3, 3), -positive(3, 3)])
    agree(jnp.linalg.cholesky, batch)
    agree(jnp.linalg.cholesky, -positive(9, 9))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 2), (3, 2), (2, 3), (9, 4), (4, 9), (33, 33), (70, 5), (5, 70)])
def test_qr(m, n, dtype):
    matrix = random(m, n, dtype=dtype)
    all_agree([(jnp.linalg.qr, matrix), (lambda x: jnp.linalg.qr(x, mode="complete"), matrix)])


@pytest.mark.parametrize(("m", "n"), [(0, 0), (3, 0), (0, 3)])
def test_qr_of_nothing(m, n):
    agree(lambda x: jnp.linalg.qr(x, mode="complete"), random(m, n))
    agree(jnp.linalg.qr, random(m, n))


@pytest.mark.parametrize(("m", "n"), [(1, 1), (3, 3), (5, 2), (2, 5), (33, 33), (9, 70)])
def test_lu(m, n):
    lu, matrix = jax.lax.linalg.lu, random(m, n)
    all_agree([(lu, matrix), (lambda x: jax.lax.linalg.lu_pivots_to_permutation(lu(x)[1], m), matrix)])


def test_lu_of_a_singular_matrix():
    agree(jax.lax.linalg.lu, np.ones((4, 4)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n", SIZES)
def test_eigh(n, dtype):
    upper = np.triu(random(n, n, dtype=dtype))
    of_upper = functools.partial(jax.lax.linalg.eigh, lower=False, symmetrize_input=False)
    all_agree([(jnp.linalg.eigh, positive(n, n, dtype=dtype)), (of_upper, upper)])


def test_eigh_of_nan_is_nan():
    agree(jnp.linalg.eigh, np.full((3, 3), np.nan))


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize(("m", "n"), [(1, 1), (3, 3), (5, 2), (2, 5), (33, 20), (9, 70)])
def test_svd(m, n, full):
    vectors, values = ({"full_matrices": full}, {"compute_uv": False})
    all_agree([(functools.partial(jnp.linalg.svd, **chosen), random(m, n)) for chosen in (vectors, values)])


@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("lower", [True, False])
@pytest.mark.parametrize("transposed", [True, False])
@pytest.mark.parametrize("unit", [True, False])
def test_triangular_solve(left, lower, transposed, unit):
    cases = []
    for shape in ((3, 2), (9, 5), (2, 4, 3)):
        k = shape[-2] if left else shape[-1]
        matrix = positive(*shape[:-2], k, k)

        def solve(a, b):
            return jax.lax.linalg.triangular_solve(
                a, b, left_side=left, lower=lower, transpose_a=transposed, unit_diagonal=unit
            )

        cases.append((solve, matrix, random(*shape)))
    all_agree(cases, tolerance=1e5)


@pytest.mark.parametrize("n", [3, 8, 40])
def test_tridiagonal_solve(n):
    bands = random(n), 5 + random(n), random(n, seed=4)
    all_agree([(jax.lax.linalg.tridiagonal_solve, *bands, random(n, k)) for k in (1, 3)])


@pytest.mark.slow
@pytest.mark.parametrize("batch", [(2,), (2, 3)])
@pytest.mark.parametrize("n", [2, 6])
def test_batches(batch, n):
    x = positive(*batch, n, n)
    of_one = [jnp.linalg.cholesky, jnp.linalg.qr, jax.lax.linalg.lu, jnp.linalg.eigh, jnp.linalg.svd]
    of_one += [jnp.linalg.inv, jnp.linalg.slogdet]
    all_agree([*((f, x) for f in of_one), (jnp.linalg.solve, x, random(*batch, n, 2))], tolerance=1e4)


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 9, 40])
def test_within_loops_and_branches(n):
    def steps(x, many):
        def step(carry, i):
            x, logs = carry
            q, r = jnp.linalg.qr(x)
            logs = logs + jnp.log(jnp.abs(jnp.diag(r)))
            turned = jax.lax.cond(i % 2 == 0, lambda y: jnp.linalg.solve(y + 3 * jnp.eye(n), y), lambda y: y.T, q)
            return (turned, logs), q[0]

        carry, rows = jax.lax.scan(step, (x, jnp.zeros(n)), jnp.arange(6))

        def again(state):
            i, y = state
            return i + 1, jnp.linalg.cholesky(y @ y.T + jnp.eye(n))

        return carry, rows, jax.lax.while_loop(lambda state: state[0] < many, again, (0, x))

    agree(steps, random(n, n), 5, tolerance=1e6)


def test_the_operand_is_still_there_afterwards():
    def used_twice(x):
        part = x[1:, 1:]
        lower = jax.lax.linalg.cholesky(part, symmetrize_input=False)
        return jnp.tril(lower), part + 1, part @ part, x

    agree(used_twice, positive(10, 10))


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 9])
def test_derivatives(n):
    derivatives = [jax.jacfwd(function) for function in (jnp.linalg.qr, jnp.linalg.cholesky, jnp.linalg.inv)]
    derivatives.append(jax.jacrev(lambda x: jnp.linalg.slogdet(x)[1]))
    all_agree([(f, positive(n, n)) for f in derivatives], tolerance=1e5)


PRODUCTS = [
    ("ij,jk->ik", (40, 33), (33, 50)), ("ji,jk->ik", (33, 40), (33, 50)), ("ij,kj->ik", (40, 33), (50, 33)),
    ("ji,kj->ik", (33, 40), (50, 33)), ("bij,bjk->bik", (3, 40, 33), (3, 33, 50)), ("ij,j->i", (90, 80), (80,)),
    ("ji,j->i", (90, 80), (90,)), ("j,jk->k", (90,), (90, 80)), ("ibj,kbj->bik", (40, 2, 33), (50, 2, 33)),
    ("j,j->", (5000,), (5000,)), ("ijk,jkl->il", (40, 8, 9), (8, 9, 30)), ("ij,kl->ijkl", (40, 20), (9, 9)),
]  # fmt: skip


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("axes", "left", "right"), PRODUCTS)
def test_large_products(axes, left, right, dtype):
    def product(x, y):
        return jnp.einsum(axes, x, y), jnp.einsum(axes, jnp.sin(x), y)

    agree(product, random(*left, dtype=dtype), random(*right, dtype=dtype), tolerance=1000)


@pytest.mark.parametrize(
    ("left", "right", "types", "by"),
    [
        ((32, 32), (32, 32), "dd", "gemm"), ((32, 32), (32, 31), "dd", None), ((32, 32), (32, 32), "fd", None),
        ((32, 32), (32, 32), "ff", "gemm"), ((32, 32), (32, 32), "ll", None), ((128, 128), (128, 2), "dd", "gemm"),
        ((64, 64), (64,), "dd", "gemv"), ((64, 63), (63,), "dd", None), ((64,), (64, 64), "dd", "gemv"),
    ],
)  # fmt: skip
def test_products_of_a_certain_size_are_those_of_blas(left, right, types, by):
    """2^15 multiplications of two matrices, 2^12 elements of one, and numbers of one type."""
    operands = [np.ones(shape, dtype) for shape, dtype in zip((left, right), types, strict=True)]
    text = lower(jax.make_jaxpr(lambda x, y: jax.lax.dot(x, y, preferred_element_type=y.dtype))(*operands), 16)
    assert [name for name in ("gemm", "gemv") if name in text] == [by] * (by is not None)


def test_what_is_missing_is_named():
    with pytest.raises(native.UnsupportedError, match="eig"):
        native.compile(jnp.linalg.eig, np.eye(3))
    with pytest.raises(native.UnsupportedError, match="complex"):
        native.compile(jnp.linalg.cholesky, np.eye(3) + 0j)
