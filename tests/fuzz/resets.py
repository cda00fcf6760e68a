"""Resets that lose rank: products of matrices of small integers, whose rank and growth are known exactly.

The frame starts as unit vectors, so that the growth of column i is ln of the distance of the product's column i from
the span of those before it, and columns in that span are lost. Fractions tell both without rounding. Where the flow, or
one matrix, turns a column exactly into the kernel of the next one, rounding hides it: then the note "unresolved" is an
answer too.
"""

import functools
import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from lyaphybrid.results.spectrum import unresolved

from .batches import in_batches, judged

N, MATRICES = 4, 3  # of the map
TICKS, COMPONENTS = 4, 3  # of the flow with a clock

PRODUCT = lh.Map(lambda n, x, args: args[jnp.asarray(n, jnp.int32) % MATRICES] @ x)
CLOCK = lh.Hybrid(
    lambda t, x, args: args["flow"] @ x, lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: args["reset"] @ x)
)


def random_matrix(draw: np.random.Generator, n: int) -> np.ndarray:
    """Small integers; often of low rank, sometimes nilpotent or zero."""
    kind = draw.random()
    if kind < 0.25:
        return draw.integers(-2, 3, (n, n))
    if kind < 0.3:
        return np.triu(draw.integers(-2, 3, (n, n)), 1)
    rank = int(draw.integers(1, n))
    return draw.integers(-2, 3, (n, rank)) @ draw.integers(-2, 3, (rank, n))


def case(seed: int) -> dict:
    """The parameters, and the product of all matrices, exactly."""
    draw = np.random.default_rng(seed)
    if seed % 2:
        flow, reset = np.triu(draw.integers(-2, 3, (COMPONENTS, COMPONENTS)), 1), random_matrix(draw, COMPONENTS)
        half = exponential(flow, Fraction(1, 2))
        turn = times(half, times(exact(reset), half))
        product = functools.reduce(times, [turn] * TICKS)
        return {"args": {"flow": flow * 1.0, "reset": reset * 1.0}, "product": product}
    matrices = np.stack([random_matrix(draw, N) for _ in range(MATRICES)])
    product = functools.reduce(lambda a, b: times(b, a), [exact(m) for m in matrices] * 2)
    return {"args": matrices * 1.0, "product": product}


def exact(matrix) -> list[list[Fraction]]:
    return [[Fraction(int(entry)) for entry in row] for row in matrix]


def times(a, b):
    return [[sum(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)] for row in a]


def exponential(flow, step: Fraction):
    """exp(flow · step) of a strictly upper triangular matrix of three rows."""
    first = [[step * entry for entry in row] for row in exact(flow)]
    second = times(first, first)
    return [[Fraction(i == j) + first[i][j] + second[i][j] / 2 for j in range(COMPONENTS)] for i in range(COMPONENTS)]


def growth_of(product) -> np.ndarray:
    """(n,) ln |R_ii|, exactly up to the last logarithm; -inf where a column is lost."""
    kept: list[list[Fraction]] = []
    found = []
    for column in zip(*product, strict=True):
        rest = list(column)
        for other in kept:
            part = sum(x * y for x, y in zip(rest, other, strict=True)) / sum(x * x for x in other)
            rest = [x - part * y for x, y in zip(rest, other, strict=True)]
        squared = sum(x * x for x in rest)
        found.append(0.5 * (math.log(squared.numerator) - math.log(squared.denominator)) if squared else -np.inf)
        kept += [rest] if squared else []
    return np.array(found)


@functools.partial(jax.jit, static_argnums=0)
def _spectra(clocked: bool, batch):
    def one(args):
        system, n, length = (CLOCK, COMPONENTS, float(TICKS)) if clocked else (PRODUCT, N, 2 * MATRICES)
        s = lh.lyapunov_spectrum(system, jnp.zeros(n), args, t1=length, blocks=2, throw=False)
        return s.exponents * length, s.losses, s.status_code, unresolved(s.spread)

    return jax.lax.map(one, batch)


def failures(seeds) -> dict[int, str]:
    """What is wrong, by seed."""
    found = {}
    for clocked in (False, True):
        chosen = [seed for seed in seeds if seed % 2 == clocked]
        answers = in_batches(functools.partial(_spectra, clocked), {seed: case(seed) for seed in chosen})
        for seed, known, (growth, losses, status, said) in answers:
            wanted = np.sort(growth_of(known["product"]))[::-1]
            lost = np.isneginf(wanted)
            size = 1 + np.max(np.abs(wanted[~lost]), initial=0.0)
            found |= judged(
                seed,
                status=status == lh.STATUS.ok,
                lost=said or (np.array_equal(np.isneginf(growth), lost) and np.sum(losses > 0) >= np.sum(lost)),
                growth=said or np.allclose(growth[~lost], wanted[~lost], rtol=0, atol=1e-7 * size),
            )
    return found
