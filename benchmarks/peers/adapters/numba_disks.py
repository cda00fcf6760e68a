"""Four hard disks as a loop for numba: all pairs and images at each collision."""

import math

import numba
import numpy as np

from benchmarks import problems
from benchmarks.peers.adapters.numba_loops import gram_schmidt

N, DIMENSION = 4, 16
(WIDTH, HEIGHT), EVERY = problems.DISKS_BOX, problems.DISKS_EVERY


@numba.njit
def next_collision(x):
    """(time, first, second, the vector between them now); first -1: a long flight, after which images are renewed."""
    earliest, a, b, apart, above, fastest = math.inf, -1, -1, 0.0, 0.0, 0.0
    for i in range(N):
        for j in range(i + 1, N):
            u, v = x[8 + 2 * j] - x[8 + 2 * i], x[9 + 2 * j] - x[9 + 2 * i]
            nearest, upper = x[2 * j] - x[2 * i], x[2 * j + 1] - x[2 * i + 1]
            nearest -= WIDTH * round(nearest / WIDTH)
            upper -= HEIGHT * round(upper / HEIGHT)
            fastest = max(fastest, u * u + v * v)
            for across in range(-1, 2):
                for along in range(-1, 2):
                    dx, dy = nearest + across * WIDTH, upper + along * HEIGHT
                    approach = dx * u + dy * v
                    if approach < 0.0:
                        gap = dx * dx + dy * dy - 1.0
                        discriminant = approach * approach - (u * u + v * v) * gap
                        if discriminant > 0.0:
                            time = gap / (math.sqrt(discriminant) - approach)
                            if time < earliest:
                                earliest, a, b, apart, above = time, i, j, dx, dy
    longest = (1.5 * WIDTH - 1.0) / math.sqrt(fastest)
    if earliest > longest:
        return longest, -1, -1, 0.0, 0.0
    return earliest, a, b, apart, above


@numba.njit
def collide(y, k, a, b, dx, dy):
    """Momenta, and the columns (16, k) by rows after the state."""
    u, v = y[8 + 2 * b] - y[8 + 2 * a], y[9 + 2 * b] - y[9 + 2 * a]
    along = dx * u + dy * v
    qa, qb, pa, pb = 2 * a, 2 * b, 8 + 2 * a, 8 + 2 * b
    for c in range(k):
        at = DIMENSION + c
        tx, ty = y[at + qb * k] - y[at + qa * k], y[at + (qb + 1) * k] - y[at + (qa + 1) * k]
        wx, wy = y[at + pb * k] - y[at + pa * k], y[at + (pb + 1) * k] - y[at + (pa + 1) * k]
        shift = -(dx * tx + dy * ty) / along
        tx, ty = tx + u * shift, ty + v * shift
        turned = dx * wx + dy * wy + u * tx + v * ty
        kx, ky = turned * dx + along * tx, turned * dy + along * ty
        y[at + qa * k] -= along * dx * shift
        y[at + (qa + 1) * k] -= along * dy * shift
        y[at + qb * k] += along * dx * shift
        y[at + (qb + 1) * k] += along * dy * shift
        y[at + pa * k] += kx
        y[at + (pa + 1) * k] += ky
        y[at + pb * k] -= kx
        y[at + (pb + 1) * k] -= ky
    y[pa] += along * dx
    y[pa + 1] += along * dy
    y[pb] -= along * dx
    y[pb + 1] -= along * dy


def loop(k: int):
    """``run(y, length) -> growth`` of state and columns."""
    orthonormalise = gram_schmidt(DIMENSION, k)

    @numba.njit
    def run(y, length):
        growth, left, collisions = np.zeros(k), length, 0
        while left > 0.0:
            time, a, b, dx, dy = next_collision(y)
            if time >= left:
                time, a = left, -1
            left -= time
            for i in range(2 * N):
                y[i] += time * y[8 + i]
                for c in range(k):
                    y[DIMENSION + i * k + c] += time * y[DIMENSION + (8 + i) * k + c]
            if a >= 0:
                dx += time * (y[8 + 2 * b] - y[8 + 2 * a])
                dy += time * (y[9 + 2 * b] - y[9 + 2 * a])
                collide(y, k, a, b, dx, dy)
                collisions += 1
            if (a >= 0 and collisions % EVERY == 0) or left <= 0.0:
                orthonormalise(y, growth)
        return growth

    return run
