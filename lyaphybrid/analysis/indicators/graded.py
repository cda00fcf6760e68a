"""Singular values, to full relative accuracy, of matrices whose row norms exceed the range of floating-point numbers.

A = diag(e^(s_i)) B, B with rows of length about 1 and s_i in the thousands. One-sided Jacobi rotations make the rows of
A orthogonal; their lengths are then the singular values. A rotation needs only the angle between two rows and the
ratio of their lengths, so e^(s_i) is never formed. Errors are the condition number of B times rounding, for any s_i
(J. Demmel & K. Veselić, SIAM J. Matrix Anal. Appl. 13 (1992) 1204, doi:10.1137/0613074).
"""

import numpy as np

__all__ = ["log_singular_values"]

SWEEPS = 60  # most sweeps over all pairs; convergence is quadratic
GONE = -1e300  # finite stand-in for ln 0, so that differences are defined


def log_singular_values(rows: np.ndarray, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values and right singular vectors of m matrices A = diag(e^s) B at once.

    Args:
        rows: (m, k, k) B; a row of zeros where its logarithm is -inf.
        logs: (m, k) s.

    Returns:
        ln of the singular values (m, k), descending; and the right singular vectors (m, k, k) as columns, zero where
        the singular value is zero.
    """
    b = np.array(rows, float)
    logs = np.where(np.isneginf(logs), GONE, logs)
    b, logs = _normalised(b, logs)
    pairs = [(i, j) for i in range(b.shape[1]) for j in range(i + 1, b.shape[1])]
    for _ in range(SWEEPS):
        b, logs = _sorted(b, logs)
        if max((_rotate(b, logs, i, j) for i, j in pairs), default=0.0) < 4 * np.finfo(float).eps:
            break
    b, logs = _sorted(b, logs)
    return np.where(logs <= GONE / 2, -np.inf, logs), np.swapaxes(b, 1, 2)


def _normalised(b, logs):
    length = np.linalg.norm(b, axis=-1)
    there = length > 0
    safe = np.where(there, length, 1.0)
    return b / safe[..., None], np.where(there, logs + np.log(safe), GONE)


def _sorted(b, logs):
    order = np.argsort(-logs, axis=1, kind="stable")
    return np.take_along_axis(b, order[:, :, None], axis=1), np.take_along_axis(logs, order, axis=1)


def _rotate(b, logs, i: int, j: int) -> float:
    """Make rows i and j orthogonal, in place; returns the largest |cosine| between them before.

    With g the cosine and ρ ≤ 1 the ratio of the lengths, tan θ = ρ τ, 2 ρ g / (1 − ρ²) = tan 2θ. As ρ → 0 this is a
    Gram–Schmidt step: τ = g.
    """
    with np.errstate(under="ignore"):
        first = logs[:, i] >= logs[:, j]  # the longer row comes first in the rotation
        long, short = (np.where(first[:, None], b[:, p], b[:, q]) for p, q in ((i, j), (j, i)))
        ratio = np.exp(-np.abs(logs[:, i] - logs[:, j]))
        cosine = np.sum(long * short, axis=1)
        off = (1 - ratio) * (1 + ratio)
        below = off + np.hypot(off, 2 * ratio * cosine)
        tau = 2 * cosine / np.where(below > 0, below, 1.0)
        tangent = ratio * tau
        c = 1 / np.sqrt(1 + tangent**2)
        shares = (1.0, ratio * tangent), (-tau, 1.0)
        turned = np.stack([c[:, None] * (p * long.T + q * short.T).T for p, q in shares])
    both = np.stack([np.maximum(logs[:, i], logs[:, j]), np.minimum(logs[:, i], logs[:, j])])
    turned, both = _normalised(turned, both)
    for place, longer in ((i, first), (j, ~first)):
        b[:, place] = np.where(longer[:, None], turned[0], turned[1])
        logs[:, place] = np.where(longer, both[0], both[1])
    return float(np.max(np.abs(cosine), initial=0.0))
