"""Rules for JAX's random numbers, with the same bits as its Threefry generator, and the inverse error function.

A key is one element of 64 bits, with its first word in the lower half: in memory this is JAX's pair of 32-bit words.
"""

import math
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.random import threefry_prng_impl

from ..elementary import arithmetic as a
from ..lowering.emitter import Entry, is_known
from ..lowering.expansion import traced
from ..lowering.lowering import Lowering, entrywise, rule, spread
from ..lowering.types import INDEX, llvm_type
from ..lowering.unsupported import UnsupportedError
from ..lowering.values import Value, filled, size

_WORD = np.dtype(np.uint32)
_PAIR = np.dtype(np.uint64)

# --- keys ------------------------------------------------------------------------------------------------------------


@rule("random_wrap")
def random_wrap(b, eqn, words):
    aval = eqn.outvars[0].aval
    llvm_type(aval.dtype)

    def at(i):
        low, high = (b.element_at(words_, [*i, place], _WORD) for place in (0, 1))
        if is_known(low, high):
            return low | high << 32
        low, high = (a.converted(b, _WORD, x, _PAIR) for x in (low, high))
        return b.binary("or", "i64", low, b.binary("shl", "i64", high, 32))

    words_ = words if b.is_small(aval.shape) else b.readable(words, _WORD)
    return _each(b, aval, at, words_)


@rule("random_unwrap")
def random_unwrap(b, eqn, keys):
    def at(i):
        *which, place = i
        key = b.element_at(keys_, which, _PAIR)
        if is_known(key, place):
            return key >> 32 * place & 0xFFFFFFFF
        return a.converted(b, _PAIR, b.binary("lshr", "i64", key, b.index_times(place, 32)), _WORD)

    aval = eqn.outvars[0].aval
    keys_ = keys if b.is_small(aval.shape) else b.readable(keys, _PAIR)
    return _each(b, aval, at, keys_)


def _each(b: Lowering, aval, at: Callable, source: Value) -> Value:
    if b.is_small(aval.shape):
        return filled(aval.shape, [at(list(i)) for i in np.ndindex(aval.shape)])
    return b.lazy(aval.shape, aval.dtype, at, [source])


def _for_each(function: Callable, ndim: int) -> Callable:
    return function if ndim == 0 else jax.vmap(_for_each(function, ndim - 1))


def _bits(keys, *, bit_width, shape):
    draw = partial(threefry_prng_impl.random_bits, bit_width=bit_width, shape=shape)
    return _for_each(draw, keys.ndim)(jax.random.key_data(keys))


def _split(keys, *, shape):
    words = _for_each(lambda key: threefry_prng_impl.split(key, shape), keys.ndim)(jax.random.key_data(keys))
    return jax.random.wrap_key_data(words, impl="threefry2x32")


def _fold_in(keys, messages):
    shape = jnp.broadcast_shapes(keys.shape, messages.shape)
    words = jnp.broadcast_to(jax.random.key_data(keys), (*shape, 2))
    words = _for_each(threefry_prng_impl.fold_in, len(shape))(words, jnp.broadcast_to(messages, shape))
    return jax.random.wrap_key_data(words, impl="threefry2x32")


def _seed(seeds, *, impl):
    if impl.name != threefry_prng_impl.name:
        raise UnsupportedError(f"keys of {impl.name}")
    words = _for_each(threefry_prng_impl.seed, seeds.ndim)(seeds)
    return jax.random.wrap_key_data(words, impl="threefry2x32")


_MADE_OF_THREEFRY = {"random_bits": _bits, "random_split": _split, "random_fold_in": _fold_in, "random_seed": _seed}


@rule(*_MADE_OF_THREEFRY)
def made_of_threefry(b, eqn, *values):
    """The jaxpr of JAX's own functions of arrays of words; so both values of `jax_threefry_partitionable` work."""
    for atom in (*eqn.invars, *eqn.outvars):
        llvm_type(atom.aval.dtype)  # raises for keys of other generators than Threefry
    function = partial(_MADE_OF_THREEFRY[eqn.primitive.name], **eqn.params)
    return b.run(traced(function, [atom.aval for atom in eqn.invars]), values)


# --- Threefry-2x32, 20 rounds ----------------------------------------------------------------------------------------
# J. Salmon, M. Moraes, R. Dror & D. Shaw, Parallel random numbers: as easy as 1, 2, 3, Proceedings of SC'11 (2011),
# paper 16, doi:10.1145/2063384.2063405

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = 0x1BD11BDA
_WRITTEN_OUT = 4  # blocks, up to which the code is unrolled; more are computed in a loop


@rule("threefry2x32")
def threefry2x32(b, eqn, *values):
    shape = eqn.outvars[0].aval.shape

    def at(i):
        return _threefry(b, *(b.element_at(v, spread(i, v.shape), _WORD) for v in operands))

    if size(shape) <= min(_WRITTEN_OUT, b.small) or b.lanes > 1:
        operands = values
        pairs = [at(list(i)) for i in np.ndindex(shape)]
        return [filled(shape, [pair[place] for pair in pairs]) for place in (0, 1)]
    operands = [b.readable(value, _WORD) for value in values]
    results = [b.new_buffer(shape, _WORD) for _ in range(2)]

    def put(i):
        for result, word in zip(results, at(i), strict=True):
            b.store_element(result, i, word)

    b.for_each_index(shape, put)
    return [b.held(result) for result in results]


def _threefry(b: Lowering, key0: Entry, key1: Entry, x0: Entry, x1: Entry) -> tuple[Entry, Entry]:
    keys = (key0, key1, _xor(b, _xor(b, key0, key1), _PARITY))
    x0, x1 = a.add(b, _WORD, x0, keys[0]), a.add(b, _WORD, x1, keys[1])
    for group in range(5):
        for by in _ROTATIONS[group % 2]:
            x0 = a.add(b, _WORD, x0, x1)
            x1 = _xor(b, x0, _rotated(b, x1, by))
        x0 = a.add(b, _WORD, x0, keys[(group + 1) % 3])
        x1 = a.add(b, _WORD, a.add(b, _WORD, x1, keys[(group + 2) % 3]), group + 1)
    return x0, x1


def _xor(b: Lowering, x: Entry, y: Entry) -> Entry:
    return x ^ y if is_known(x, y) else b.binary("xor", "i32", x, y, commutes=True)


def _rotated(b: Lowering, x: Entry, by: int) -> Entry:
    if is_known(x):
        return (x << by | x >> (32 - by)) & 0xFFFFFFFF
    return b.intrinsic("llvm.fshl", "i32", [x, x, by])


@rule("iota_2x32_shape")
def counters(b, eqn):
    """The linear index of each element, as two 32-bit words."""

    def word(aval, shift):
        def at(i):
            place = b.linear_index(i, aval.shape)
            if is_known(place):
                return place >> shift & 0xFFFFFFFF
            return a.converted(b, INDEX, b.binary("lshr", "i64", place, shift), _WORD)

        if b.is_small(aval.shape):
            return filled(aval.shape, [at(list(i)) for i in np.ndindex(aval.shape)])
        return b.lazy(aval.shape, aval.dtype, at, [], cheap=True)

    return [word(variable.aval, shift) for variable, shift in zip(eqn.outvars, (32, 0), strict=True)]


# --- the inverse error function --------------------------------------------------------------------------------------
# M. Giles, Approximating the erfinv function, GPU Computing Gems Jade Edition (2012) 109,
# doi:10.1016/B978-0-12-385963-1.00010-1; the same polynomials as in XLA. Each: the upper limit of w, whether the
# variable is √w − s instead of w − s, the shift s, the coefficients from the highest degree to the lowest.

_DOUBLE = (
    (6.25, False, 3.125, (
        -3.6444120640178196996e-21, -1.685059138182016589e-19, 1.2858480715256400167e-18, 1.115787767802518096e-17,
        -1.333171662854620906e-16, 2.0972767875968561637e-17, 6.6376381343583238325e-15, -4.0545662729752068639e-14,
        -8.1519341976054721522e-14, 2.6335093153082322977e-12, -1.2975133253453532498e-11, -5.4154120542946279317e-11,
        1.051212273321532285e-09, -4.1126339803469836976e-09, -2.9070369957882005086e-08, 4.2347877827932403518e-07,
        -1.3654692000834678645e-06, -1.3882523362786468719e-05, 0.0001867342080340571352, -0.00074070253416626697512,
        -0.0060336708714301490533, 0.24015818242558961693, 1.6536545626831027356,
    )),
    (16.0, True, 3.25, (
        2.2137376921775787049e-09, 9.0756561938885390979e-08, -2.7517406297064545428e-07, 1.8239629214389227755e-08,
        1.5027403968909827627e-06, -4.013867526981545969e-06, 2.9234449089955446044e-06, 1.2475304481671778723e-05,
        -4.7318229009055733981e-05, 6.8284851459573175448e-05, 2.4031110387097893999e-05, -0.0003550375203628474796,
        0.00095328937973738049703, -0.0016882755560235047313, 0.0024914420961078508066, -0.0037512085075692412107,
        0.005370914553590063617, 1.0052589676941592334, 3.0838856104922207635,
    )),
    (math.inf, True, 5.0, (
        -2.7109920616438573243e-11, -2.5556418169965252055e-10, 1.5076572693500548083e-09, -3.7894654401267369937e-09,
        7.6157012080783393804e-09, -1.4960026627149240478e-08, 2.9147953450901080826e-08, -6.7711997758452339498e-08,
        2.2900482228026654717e-07, -9.9298272942317002539e-07, 4.5260625972231537039e-06, -1.9681778105531670567e-05,
        7.5995277030017761139e-05, -0.00021503011930044477347, -0.00013871931833623122026, 1.0103004648645343977,
        4.8499064014085844221,
    )),
)  # fmt: skip
_SINGLE = (
    (5.0, False, 2.5, (
        2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087, -0.00125372503, -0.00417768164,
        0.246640727, 1.50140941,
    )),
    (math.inf, True, 3.0, (
        -0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773, -0.0076224613, 0.00943887047,
        1.00167406, 2.83297682,
    )),
)  # fmt: skip


@entrywise("erf_inv")
def erf_inv(b, eqn, dtypes, x):
    dtype = dtypes[0]
    type_, pieces = llvm_type(dtype), _DOUBLE if dtype == np.float64 else _SINGLE
    if type_ not in ("double", "float"):
        raise UnsupportedError(f"erf_inv of {dtype}")
    minus_square = a.negate(b, dtype, a.multiply(b, dtype, x, x))
    w = a.negate(b, dtype, b.call("log1p" if type_ == "double" else "log1pf", type_, [minus_square]))
    found = None
    for limit, rooted, less, coefficients in reversed(pieces):
        y = a.subtract(b, dtype, b.intrinsic("llvm.sqrt", type_, [w]) if rooted else w, less)
        value: Entry = coefficients[0]
        for coefficient in coefficients[1:]:
            value = a.add(b, dtype, coefficient, a.multiply(b, dtype, value, y))
        within = a.compare(b, dtype, "lt", w, limit)
        found = value if found is None else b.select(within, type_, value, found)
    at_end = a.equal(b, dtype, a.absolute(b, dtype, x), 1.0)
    return b.select(at_end, type_, a.multiply(b, dtype, x, math.inf), a.multiply(b, dtype, x, found))
