"""Four hard disks of diameter and mass 1 as a user of NumPy writes them: straight flights, elastic collisions.

The state is (q (4, 2), p (4, 2)), a column the same. In NumPy's long doubles it gives the converged values.
"""

import numpy as np

from benchmarks import problems
from benchmarks.peers.workloads import Workload

N = 4
FIRST, SECOND = np.triu_indices(N, 1)
AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
BOX = np.array(problems.DISKS_BOX)


def next_collision(q, p, box):
    """(time to it, pair, the vector between the centres now); pair -1: a flight so long that images must be renewed."""
    apart, speed = q[SECOND] - q[FIRST], p[SECOND] - p[FIRST]
    apart = apart - box * np.rint(apart / box)
    images = apart[:, None] + AROUND * box
    approach = np.sum(images * speed[:, None], axis=2)
    gap = np.sum(images**2, axis=2) - 1.0
    discriminant = approach**2 - np.sum(speed**2, axis=1)[:, None] * gap
    hits = (approach < 0.0) & (discriminant > 0.0)
    times = np.full_like(gap, np.inf)
    times[hits] = gap[hits] / (np.sqrt(discriminant[hits]) - approach[hits])
    pair, image = np.unravel_index(np.argmin(times), times.shape)
    longest = (1.5 * np.min(box) - 1.0) / np.sqrt(np.max(np.sum(speed**2, axis=1)))
    if times[pair, image] > longest:
        return longest, -1, images[0, 0]
    return times[pair, image], pair, images[pair, image]


def collide(pair, between, p, dq, dp):
    """Momenta and columns across the collision: each column to its own instant, through the reset, and back."""
    a, b = FIRST[pair], SECOND[pair]
    speed = p[b] - p[a]
    along = between @ speed
    shift = -(between @ (dq[b] - dq[a])) / along  # (k,) of the instant of each column
    touching = dq[b] - dq[a] + speed[:, None] * shift
    kick = along * between
    turned = between @ (dp[b] - dp[a]) + speed @ touching
    dkick = turned * between[:, None] + along * touching
    for disk, sign in ((a, 1.0), (b, -1.0)):
        dq[disk] -= sign * kick[:, None] * shift
        dp[disk] += sign * dkick
        p[disk] += sign * kick


def growth(start, columns, length, orthonormalise, box=BOX) -> np.ndarray:
    """Σ ln R_ii; `orthonormalise` gives Q and the diagonal of R."""
    (q, p), (dq, dp) = start.reshape(2, N, 2).copy(), columns.reshape(2, N, 2, -1).copy()
    total, left, collisions = np.zeros(columns.shape[1], columns.dtype), length, 0
    while left > 0.0:
        time, pair, between = next_collision(q, p, box)
        if time >= left:
            time, pair = left, -1
        left -= time
        q += p * time
        dq += dp * time
        if pair >= 0:
            collide(pair, between + (p[SECOND[pair]] - p[FIRST[pair]]) * time, p, dq, dp)
            collisions += 1
        if (pair >= 0 and collisions % problems.DISKS_EVERY == 0) or left <= 0.0:
            columns, diagonal = orthonormalise(np.concatenate([dq, dp]).reshape(4 * N, -1))
            dq, dp = columns.reshape(2, N, 2, -1).copy()
            total += np.log(np.abs(diagonal))
    return total


def gram_schmidt(columns):
    """Modified, for long doubles, which LAPACK does not know."""
    columns, lengths = columns.copy(), []
    for c in range(columns.shape[1]):
        lengths.append(np.sqrt(columns[:, c] @ columns[:, c]))
        columns[:, c] /= lengths[-1]
        columns[:, c + 1 :] -= np.outer(columns[:, c], columns[:, c] @ columns[:, c + 1 :])
    return columns, np.array(lengths)


def converged_growth(workload: Workload, columns: np.ndarray) -> np.ndarray:
    """In long doubles."""
    start, columns, box = (np.array(part, np.longdouble) for part in (workload.start, columns, BOX))
    return np.asarray(growth(start, columns, np.longdouble(workload.short), gram_schmidt, box), float)
