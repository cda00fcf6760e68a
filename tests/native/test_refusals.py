"""What the compiler does not take it refuses by one error, with what it was."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from lyaphybrid import native
from lyaphybrid._jax.engines import compiled
from lyaphybrid.native.lowering.values import Values

X, SQUARE = np.array([1.0, 2.0, 3.0]), np.diag([1.0, 2.0, 3.0])
HALVES = {np.dtype(np.float16): "float16", jnp.dtype(jnp.bfloat16): "bfloat16"}


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: lax.bitcast_convert_type(x, np.int32), "bitcast_convert_type that changes the number of axes"),
        (lambda x: lax.bitcast_convert_type(x[0], np.int32), "bitcast_convert_type between sizes"),
        (lambda x: lax.reduce_precision(x, 5, 10), "reduce_precision to a type that is no type of LLVM"),
        (lambda x: x.at[np.array([0, 2])].get(mode="one_hot"), "gather in the mode one_hot"),
        (lambda x: x.at[np.array([0, 2])].set(1.0, mode="one_hot"), "scatter in the mode one_hot"),
        (lambda x: lax.reduce(x, 0.0, lambda a, b: a + 2 * b, (0,)), "the primitive reduce"),
        (lambda x: lax.igamma(x, x), "the primitive igamma"),
        (lambda x: lax.pow(x, np.arange(3, dtype=np.int32)), "pow of float64, int32"),
    ],
)
def test_of_arrays(function, message):
    with pytest.raises(native.UnsupportedError, match=message):
        native.compile(function, X)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: lax.linalg.eigh(x, subset_by_index=(0, 2)), "eigh of a part of the spectrum"),
        (lambda x: lax.linalg.svd(x, full_matrices=False, subset_by_index=(0, 2)), "svd of a part"),
        (lambda x: lax.linalg.svd(x[:0]), "svd of a part, or of an empty matrix"),
        (lambda x: lax.linalg.qr(x, pivoting=True), "qr with pivoting"),
    ],
)
def test_of_matrices(function, message):
    with pytest.raises(native.UnsupportedError, match=message):
        native.compile(function, SQUARE)


@pytest.mark.parametrize("dtype", HALVES, ids=str)
@pytest.mark.parametrize(
    "function", [lax.erf_inv, lax.erf, lax.sort, lambda x: x * x], ids=["erf_inv", "erf", "sort", "*"]
)
def test_of_short_numbers(function, dtype):
    with pytest.raises(native.UnsupportedError, match=f"elements of type {HALVES[dtype]}"):
        native.compile(function, np.ones(3, dtype))


def test_vectors_of_columns_and_of_lanes_at_once():
    with pytest.raises(ValueError, match="either the columns of frames or lanes"):
        Values(16, columns=2, lanes=2)


@pytest.mark.parametrize("engine", ["auto", "xla"])
def test_xla_takes_what_is_refused(engine, monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", engine)
    halves = compiled()(lambda x: lax.bitcast_convert_type(x, np.int32))
    assert np.asarray(halves(jnp.asarray(X)))[:, 1].tolist() == [0x3FF00000, 0x40000000, 0x40080000]
