"""Frozen noise: random numbers that are functions of a seed and a count, the same whoever asks, and how often."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._arguments import is_one_of, require
from ..._jax.tracing import traced

__all__ = ["frozen_noise"]

KINDS_OF_NOISE = {"normal": jax.random.normal, "uniform": jax.random.uniform, "exponential": jax.random.exponential}
WORD = 2.0**32  # counts are split into two words of 32 bits


def frozen_noise(seed: Any, count: Any, shape: tuple[int, ...] = (), kind: str = "normal") -> Array:
    """Independent random numbers for each count: the noise of a random map, or of random kicks, inputs and resets.

    A random system with *frozen* noise is a system that depends on time. All perturbations, all starts and all points
    of a sweep see the same noise if they have the same seed; no state has to be carried along, a run can be taken up
    anywhere, and derivatives by parameters are at fixed noise.

    - In a map: ``frozen_noise(args["seed"], n)``, n the iteration.
    - In the reset of a clock: ``frozen_noise(args["seed"], t / every)``; the count is rounded to an integer.
    - An input that stays constant between ticks is a component of the state that a clock sets; fields must be smooth.

    Args:
        seed: a whole number from 0 to 2**64 − 1 (in single precision 2**32 − 1), or an array of one, such as an entry
            of `args`; there ``jnp.asarray(3)`` may change, while each new Python integer is compiled anew.
        count: a number, rounded to an integer, from −2**53 to 2**53; of nan there is none: nan.
        shape: of the array.
        kind: "normal" (mean 0, variance 1), "uniform" (from 0 to 1) or "exponential" (mean 1).

    Returns:
        An array of that shape, of the floating type of `count`; nan for a seed that is not whole, where its value is
        known only as the program runs.

    Raises:
        ValueError: on another kind; on a seed that is not whole, negative or too large.

    Source:
        J. K. Salmon, M. A. Moraes, R. O. Dror & D. E. Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11 (2011),
        doi:10.1145/2063384.2063405, for numbers from counters; L. Arnold, Random Dynamical Systems (Springer 1998),
        doi:10.1007/978-3-662-12878-7, for their exponents.

    Example:
        A decay that is multiplied by 1 + ξ/2 at each tick of a clock.

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def kick(t, x, args):
        ...     return x * (1 + 0.5 * lh.frozen_noise(args["seed"], t / 0.1))
        >>> kicked = lh.Hybrid(lambda t, x, args: -x, lh.Transition(every=0.1, reset=kick))
        >>> s = lh.lyapunov_spectrum(kicked, [1.0], {"seed": 3}, t1=400.0)
        >>> bool(abs(s.exponents[0] - (-1 - 0.146 / 0.1)) < 0.3)  # −1 + ⟨ln|1 + ξ/2|⟩ / 0.1
        True
    """
    require(is_one_of(kind, KINDS_OF_NOISE), f"kind must be one of {list(KINDS_OF_NOISE)}; got {kind!r}.")
    count, seed = jnp.asarray(count), _whole_seed(seed)
    dtype = count.dtype if jnp.issubdtype(count.dtype, jnp.floating) else jnp.zeros(()).dtype
    whole = jnp.round(jax.lax.stop_gradient(count).astype(dtype))
    high = jnp.floor(whole / WORD)
    low = whole - high * WORD
    key = jax.random.key(seed.astype(jax.dtypes.canonicalize_dtype("uint64")))
    for word in (high % WORD, low):
        key = jax.random.fold_in(key, word.astype(jnp.uint32))
    known = jnp.isfinite(whole) & (seed >= 0)
    if jnp.issubdtype(seed.dtype, jnp.floating):
        known = known & (seed == jnp.floor(seed))
    return jnp.where(known, KINDS_OF_NOISE[kind](key, shape, dtype), jnp.nan)


def _whole_seed(seed: Any) -> Array:
    """The seed as an array; refused where it is known not to be whole."""
    if not traced(seed):
        value = np.asarray(seed)
        require(
            value.dtype.kind not in "fc" or bool(np.all(np.isfinite(value) & (value == np.floor(value)))),
            f"frozen_noise takes a seed that is a whole number, and others would have the noise of one; got {seed!r}.",
        )
        require(
            bool(np.all(value >= 0)), f"frozen_noise takes a seed from 0 on, as a negative one is none; got {seed!r}."
        )
        unsigned = jax.dtypes.canonicalize_dtype("uint64")
        most = int(np.iinfo(unsigned).max)
        require(
            bool(np.all(value <= most)),
            f"frozen_noise takes a seed up to {most} at this precision; got {seed!r}. Take a smaller one, or float64.",
        )
        seed = value.astype(unsigned) if value.dtype.kind in "iu" else seed  # JAX takes signed Python integers only
    return jnp.asarray(seed)
