"""The impact oscillator beside its grazing orbit, in closed form to 40 digits.

x'' + 2ζx' + x = A cos ωt at a wall at the amplitude of the steady motion: that orbit grazes. An orbit that meets the
wall at the same phase with the velocity u instead is followed back to its start; from there all is known, with one
impact.
"""

from typing import NamedTuple

import mpmath
import numpy as np

import lyaphybrid as lh

SYSTEM = lh.zoo.impact_oscillator().system
METHODS = {
    "default": None,
    "dopri8 tight": lh.RungeKutta(rtol=1e-12, atol=1e-14),
    "dopri5": lh.RungeKutta("dopri5"),
    "dopri5 loose": lh.RungeKutta("dopri5", rtol=1e-6, atol=1e-8),
    "rk4 short": lh.RungeKutta("rk4", dt=0.01),
    "rk4": lh.RungeKutta("rk4", dt=0.05),
    "rk4 long": lh.RungeKutta("rk4", dt=0.1),
    "dopri5 steps": lh.RungeKutta("dopri5", dt=0.1),
    "dopri8 steps": lh.RungeKutta("dopri8", dt=0.25),
    "ESDIRK": lh.ESDIRK(),
    "RadauIIA": lh.RadauIIA(),
}
STATED = 1e-2  # two digits, of the growth, of the derivative and of the state
OMEGA, ZETA, AMPLITUDE = 0.8, 0.05, 1.0
BEFORE, AFTER = 2.03, 1.5  # time before and after the impact; no step ends there unless a test asks for it
DIGITS = 40


class GrazingCase(NamedTuple):
    x0: np.ndarray  # (2,) rounded to the type, and exact from there on
    t0: float
    t1: float
    args: dict
    speed: float  # of the impact
    end: np.ndarray  # (2,)
    matrix: np.ndarray  # (2, 2) the derivative of the end by the start
    by_gap: np.ndarray  # (2,) and by the position of the wall
    growth: np.ndarray  # (2,) ln of the diagonal of R, the matrix being QR


def grazing_case(speed: float, restitution: float, dtype=np.float64, before: float = BEFORE) -> GrazingCase:
    """An orbit that meets the wall with a speed; it is that of the rounded start, so very small ones are not met."""
    with mpmath.workdps(DIGITS):
        omega, r = mpmath.mpf(OMEGA), mpmath.mpf(float(dtype(restitution)))
        gap = mpmath.mpf(float(dtype(AMPLITUDE / mpmath.hypot(1 - omega**2, 2 * mpmath.mpf(ZETA) * omega))))
        touch = (mpmath.atan2(2 * mpmath.mpf(ZETA) * omega, 1 - omega**2) + 2 * mpmath.pi) / omega
        t0 = mpmath.mpf(float(dtype(touch - before)))
        x0 = np.array([float(value) for value in _flow((gap, mpmath.mpf(speed)), touch, t0)[0]], dtype)
        t1 = mpmath.mpf(float(dtype(before + AFTER)))
        end, matrix, by_gap, u = _with_one_impact([mpmath.mpf(float(x)) for x in x0], t0, t0 + t1, touch, gap, r)
        factors = mpmath.qr(matrix)[1]
        growth = [float(mpmath.log(abs(factors[i, i]))) for i in range(2)]
    args = {"omega": OMEGA, "zeta": ZETA, "restitution": float(r), "gap": float(gap), "amplitude": AMPLITUDE}
    args = {name: dtype(value) for name, value in args.items()}
    numbers = [np.array(values.tolist(), float) for values in (end, matrix, by_gap)]
    return GrazingCase(
        x0, float(t0), float(t1), args, float(u), numbers[0].ravel(), numbers[1], numbers[2].ravel(), np.array(growth)
    )


def growth_of(case: GrazingCase, method) -> tuple[bool, float]:
    """Whether a spectrum says that it grazes, and the largest relative error of its growth factors e^{λt}."""
    how = {"t0": case.t0, "t1": case.t1, "method": method, "throw": False}
    found = lh.lyapunov_spectrum(SYSTEM, case.x0, case.args, blocks=2, **how)
    assert found.status is lh.STATUS.ok
    off = np.asarray(found.exponents) * case.t1 - np.sort(case.growth)[::-1]
    return "grazing" in found.notes, float(np.max(np.abs(np.expm1(off))))


def _steady(t):
    """The steady motion (x, v), the start's influence being gone."""
    omega, zeta = mpmath.mpf(OMEGA), mpmath.mpf(ZETA)
    size = (1 - omega**2) ** 2 + (2 * zeta * omega) ** 2
    c, s = (1 - omega**2) * AMPLITUDE / size, 2 * zeta * omega * AMPLITUDE / size
    return mpmath.matrix(
        [
            c * mpmath.cos(omega * t) + s * mpmath.sin(omega * t),
            omega * (s * mpmath.cos(omega * t) - c * mpmath.sin(omega * t)),
        ]
    )


def _flow(state, t, later):
    """The state at a later (or earlier) time, and its derivative by the state, without impacts."""
    zeta, step = mpmath.mpf(ZETA), later - t
    damped = mpmath.sqrt(1 - zeta**2)
    decay, co, si = mpmath.exp(-zeta * step), mpmath.cos(damped * step), mpmath.sin(damped * step)
    matrix = decay * mpmath.matrix([[co + zeta / damped * si, si / damped], [-si / damped, co - zeta / damped * si]])
    return matrix * (mpmath.matrix(state) - _steady(t)) + _steady(later), matrix


def _acceleration(t, x, v):
    return AMPLITUDE * mpmath.cos(mpmath.mpf(OMEGA) * t) - x - 2 * mpmath.mpf(ZETA) * v


def _with_one_impact(x0, t0, end, guess, gap, r):
    """The end, its derivatives by the start and by the wall's position, and the speed of the impact."""
    t = guess
    for _ in range(200):  # Newton's method: only linear where the orbit nearly grazes
        (x, u), first = _flow(x0, t0, t)
        t += (gap - x) / u
        if abs(gap - x) < mpmath.mpf(10) ** (8 - DIGITS):
            break
    u = _flow(x0, t0, t)[0][1]
    before, after = _acceleration(t, gap, u), _acceleration(t, gap, -r * u)
    kick = (after + r * before) / u  # what S has beside the reset: velocities differ by it per unit of x
    saltation = mpmath.matrix([[-r, 0], [kick, -r]])
    last, second = _flow((gap, -r * u), t, end)
    # A wall that is farther by dg is as a start that is nearer by dg, and all is shifted by dg afterwards.
    by_gap = second * (mpmath.matrix([1, 0]) - saltation * mpmath.matrix([1, 0]))
    return last, second * saltation * first, by_gap, u
