"""Equations of many components, each as symbolic programs, arrays and loops take it.

`components(m)` gives a list; `array(xp)` an array; `tangent(xp)` the derivative times columns (n, k); `loop(n, k, p)` a
function ``rhs(t, y, out)`` of the state and the columns by rows, which numba compiles.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Large(NamedTuple):
    """One formula in four forms; a potential where there is one: `potential(xp)(q, p)`."""

    components: Callable
    array: Callable
    tangent: Callable
    loop: Callable
    potential: Callable | None = None
    dense: bool = False  # each component depends on all: what differentiates entry by entry needs hours


def _lorenz96_components(m):
    def field(t, x, p):
        n, (forcing,) = len(x), p
        return [(x[(i + 1) % n] - x[i - 2]) * x[i - 1] - x[i] + forcing for i in range(n)]

    return field


def _lorenz96_array(xp):
    def field(t, x, p):
        return (xp.roll(x, -1) - xp.roll(x, 2)) * xp.roll(x, 1) - x + p[0]

    return field


def _lorenz96_tangent(xp):
    def tangent(t, x, p, v):
        across, behind = (xp.roll(x, -1) - xp.roll(x, 2))[:, None], xp.roll(x, 1)[:, None]
        return (xp.roll(v, -1, 0) - xp.roll(v, 2, 0)) * behind + across * xp.roll(v, 1, 0) - v

    return tangent


def _lorenz96_loop(n, k, p):
    (forcing,) = p

    def rhs(t, y, out):
        for i in range(n):
            after, before, far = (i + 1) % n, (i - 1) % n, (i - 2) % n
            across, behind = y[after] - y[far], y[before]
            out[i] = across * behind - y[i] + forcing
            for c in range(n, n + k):  # entries of column c - n
                turned = (y[after * k + c] - y[far * k + c]) * behind + across * y[before * k + c]
                out[i * k + c] = turned - y[i * k + c]

    return rhs


def frequencies(n: int) -> np.ndarray:
    """Of the oscillators (n,)."""
    return np.linspace(-1.0, 1.0, n)


def _kuramoto_components(m):
    def field(t, x, p):
        n, (coupling,) = len(x), p
        sines, cosines = [m.sin(one) for one in x], [m.cos(one) for one in x]
        s, c, omega = sum(sines) * (coupling / n), sum(cosines) * (coupling / n), frequencies(n).tolist()
        return [omega[i] + s * cosines[i] - c * sines[i] for i in range(n)]

    return field


def _kuramoto_array(xp):
    def field(t, x, p):
        s, c = xp.sin(x), xp.cos(x)
        return xp.asarray(frequencies(len(x))) + p[0] * (xp.mean(s) * c - xp.mean(c) * s)

    return field


def _kuramoto_tangent(xp):
    def tangent(t, x, p, v):
        s, c = xp.sin(x), xp.cos(x)
        own = (xp.mean(s) * s + xp.mean(c) * c)[:, None] * v
        along, across = xp.mean(c[:, None] * v, axis=0), xp.mean(s[:, None] * v, axis=0)
        return p[0] * (c[:, None] * along + s[:, None] * across - own)

    return tangent


def _kuramoto_loop(n, k, p):
    (coupling,), omega = p, frequencies(n)

    def rhs(t, y, out):
        sines, cosines = np.sin(y[:n]), np.cos(y[:n])
        s, c = coupling / n * np.sum(sines), coupling / n * np.sum(cosines)
        along, across = np.zeros(k), np.zeros(k)
        for i in range(n):
            for j in range(k):
                along[j] += coupling / n * cosines[i] * y[n + i * k + j]
                across[j] += coupling / n * sines[i] * y[n + i * k + j]
        for i in range(n):
            out[i] = omega[i] + s * cosines[i] - c * sines[i]
            own = s * sines[i] + c * cosines[i]
            for j in range(k):
                at = n + i * k + j
                out[at] = cosines[i] * along[j] + sines[i] * across[j] - own * y[at]

    return rhs


def _fpu_components(m):
    def field(t, x, p):
        n, (beta,) = len(x) // 2, p
        q = [0.0, *(x[i] for i in range(n)), 0.0]
        tensions = [(b - a) * (1.0 + beta * (b - a) * (b - a)) for a, b in zip(q, q[1:], strict=False)]
        return [*(x[n + i] for i in range(n)), *(tensions[i + 1] - tensions[i] for i in range(n))]

    return field


def _stretches(xp, q):
    """Of the springs (n + 1, …), the ends fixed."""
    end = xp.zeros((1, *q.shape[1:]))
    return xp.diff(xp.concatenate([end, q, end]), axis=0)


def _fpu_array(xp):
    def field(t, x, p):
        n = len(x) // 2
        d = _stretches(xp, x[:n])
        return xp.concatenate([x[n:], xp.diff(d + p[0] * d**3)])

    return field


def _fpu_tangent(xp):
    def tangent(t, x, p, v):
        n = len(x) // 2
        d = _stretches(xp, x[:n])
        tensions = (1.0 + 3.0 * p[0] * d**2)[:, None] * _stretches(xp, v[:n])
        return xp.concatenate([v[n:], xp.diff(tensions, axis=0)])

    return tangent


def _fpu_loop(size, k, p):
    (beta,), n = p, size // 2

    def rhs(t, y, out):
        for i in range(size * (k + 1)):
            out[i] = 0.0
        for i in range(n):
            out[i] = y[n + i]
            for c in range(k):
                out[size + i * k + c] = y[size + (n + i) * k + c]
        for spring in range(n + 1):  # from mass spring - 1 to mass spring
            d = (y[spring] if spring < n else 0.0) - (y[spring - 1] if spring > 0 else 0.0)
            stiffness = 1.0 + 3.0 * beta * d * d
            for c in range(-1, k):  # the state, then the columns
                at, step, first = (0, 1, 0) if c < 0 else (size, k, c)
                right = y[at + spring * step + first] if spring < n else 0.0
                left = y[at + (spring - 1) * step + first] if spring > 0 else 0.0
                tension = d * (1.0 + beta * d * d) if c < 0 else stiffness * (right - left)
                if spring < n:
                    out[at + (n + spring) * step + first] -= tension
                if spring > 0:
                    out[at + (n + spring - 1) * step + first] += tension

    return rhs


def _fpu_potential(xp):
    def potential(q, p):
        d = _stretches(xp, q)
        return xp.sum(d**2 / 2 + p[0] * d**4 / 4)

    return potential


LORENZ96 = Large(_lorenz96_components, _lorenz96_array, _lorenz96_tangent, _lorenz96_loop)
KURAMOTO = Large(_kuramoto_components, _kuramoto_array, _kuramoto_tangent, _kuramoto_loop, dense=True)
FPU = Large(_fpu_components, _fpu_array, _fpu_tangent, _fpu_loop, _fpu_potential)


def lorenz96_start(n: int) -> tuple[float, ...]:
    """Near the rest point, at which all are 8."""
    return tuple(8.0 + math.sin(i) for i in range(n))


def kuramoto_start(n: int) -> tuple[float, ...]:
    """Spread evenly."""
    return tuple(2.0 * math.pi * i / n for i in range(n))
