"""The native compiler's random numbers against XLA's: the same bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import erfinv

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options
from lyaphybrid.native.lowering.lowering import lower

PLANS = (Options(1, 2), Options(64, 2))


def words(x):
    return jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x


def all_agree(functions, *operands, **how):
    """Each function alone, against one program of XLA's for all of them."""
    wanted = jax.jit(lambda *operands: [function(*operands) for function in functions])(*operands)
    for function, expected in zip(functions, wanted, strict=True):
        agree(function, *operands, wanted=expected, **how)


def agree(function, *operands, exactly=True, roundings=8, wanted=None):
    expected = jax.tree.leaves(jax.jit(function)(*operands) if wanted is None else wanted)
    for plan in PLANS:
        found = jax.tree.leaves(native.compile(function, *operands, plan=plan, checked=True)(*operands))
        for x, y in zip(found, expected, strict=True):
            assert x.shape == y.shape
            assert x.dtype == y.dtype
            if exactly:
                np.testing.assert_array_equal(words(x), words(y), err_msg=str(plan))
            else:
                eps = np.finfo(y.dtype).eps
                np.testing.assert_allclose(x, y, rtol=roundings * eps, atol=4 * eps, err_msg=str(plan))


@pytest.fixture(params=[True, False], ids=["partitionable", "original"])
def counting(request):
    with jax.threefry_partitionable(request.param):
        yield


KEYS = [lambda: jax.random.key(7), lambda: jax.random.PRNGKey(7)]


@pytest.mark.slow_cases(
    "partitionable-shape2-typed",
    "partitionable-shape4-typed",
    "partitionable-shape4-raw",
    "original-shape3-typed",
    "original-shape3-raw",
    "original-shape4-typed",
    "original-shape4-raw",
    "partitionable-shape2-raw",
    "partitionable-shape3-typed",
    "original-shape2-typed",
    "partitionable-shape0-raw",
    "original-shape0-typed",
    "partitionable-shape0-typed",
    "original-shape0-raw",
    "partitionable-shape3-raw",
    "original-shape2-raw",
)
@pytest.mark.usefixtures("counting")
@pytest.mark.parametrize("key", KEYS, ids=["typed", "raw"])
@pytest.mark.parametrize("shape", [(), (1,), (3,), (5, 2), (101,)])
def test_bits(key, shape):
    types = ("uint8", "uint16", "uint32", "uint64")
    bits = [lambda k, dtype=dtype: jax.random.bits(k, shape, dtype) for dtype in types]
    others = [lambda k: jax.random.randint(k, shape, -3, 17), lambda k: jax.random.bernoulli(k, 0.3, shape)]
    all_agree([*bits, *others], key())


@pytest.mark.slow
@pytest.mark.usefixtures("counting")
@pytest.mark.parametrize("key", KEYS, ids=["typed", "raw"])
def test_keys_from_keys(key):
    agree(jax.random.split, key())
    agree(lambda k: jax.random.split(k, (3, 30))[1], key())
    agree(lambda k, i: jax.random.fold_in(k, i), key(), 12)
    agree(lambda k: [jax.random.fold_in(each, 3) for each in jax.random.split(k, 3)], key())


def test_keys_from_seeds():
    agree(jax.random.key, 12)
    agree(jax.random.PRNGKey, -(2**40))
    agree(lambda: jax.random.uniform(jax.random.key(3)))
    agree(jax.vmap(jax.random.key), np.arange(70))


@pytest.mark.slow_cases("shape2-float32", "shape2-float64")
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("shape", [(), (5,), (200,)])
def test_uniform_and_normal(shape, dtype):
    agree(lambda k: jax.random.uniform(k, shape, dtype), jax.random.key(1))
    agree(lambda k: jax.random.normal(k, shape, dtype), jax.random.key(1), exactly=False)
    agree(lambda k: jax.random.exponential(k, shape, dtype), jax.random.key(1), exactly=False, roundings=100)


@pytest.mark.slow
@pytest.mark.usefixtures("counting")
def test_arrays_of_keys():
    keys = jax.random.split(jax.random.key(2), 6)
    agree(jax.vmap(lambda k: jax.random.bits(k, (3,))), keys)
    agree(jax.vmap(jax.random.fold_in), keys, np.arange(6))
    agree(lambda ks: (ks[::-1], ks.reshape(2, 3), jnp.concatenate([ks, ks[:1]]), ks[2]), keys)
    agree(lambda ks, i: jax.random.bits(ks[i]), keys, 4)
    agree(lambda ks: jax.random.key_data(ks), jax.random.split(keys[0], 90))


def test_keys_that_a_loop_reads_lie_in_memory():
    """Not chosen from by comparisons: nine keys are few, their eighteen words are many."""

    def words_again(words):
        return jax.random.key_data(jax.random.wrap_key_data(words))

    words = np.arange(18, dtype=np.uint32).reshape(9, 2)
    assert " select " not in lower(jax.make_jaxpr(words_again)(words), 16)
    agree(words_again, words)


@pytest.mark.slow
def test_within_loops_and_branches():
    held = jax.random.key(5)

    def walk(key, many):
        def step(key, i):
            key, own = jax.random.split(key)
            own = jax.lax.cond(i % 3 == 0, lambda k: jax.random.fold_in(k, i), lambda k: held, own)
            own = jnp.where(i == 4, key, own)
            return key, (own, jax.random.bits(own, (3,)))

        key, drawn = jax.lax.scan(step, key, jnp.arange(8))

        def again(state):
            i, key, total = state
            key, own = jax.random.split(key)
            return i + 1, key, total + jax.random.bits(own, (), "uint32")

        return drawn, jax.lax.while_loop(lambda state: state[0] < many, again, (0, key, jnp.uint32(0)))

    agree(walk, jax.random.key(9), 5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_inverse_error_function(dtype):
    near = 1 - 2.0 ** -np.arange(1, 53)
    x = np.concatenate([np.linspace(-1, 1, 1001), near, -near, [np.nan, 1.5, 1e-300, -0.0]]).astype(dtype)
    agree(erfinv, x, exactly=False)


@pytest.mark.slow
def test_permutations_and_choices():
    agree(lambda k: jax.random.permutation(k, 40), jax.random.key(1))
    agree(lambda k: jax.random.choice(k, 20, (5,), replace=False), jax.random.key(1))


def test_other_generators_are_refused():
    with pytest.raises(native.UnsupportedError, match="rbg"):
        native.compile(jax.random.bits, jax.random.key(1, impl="rbg"))
