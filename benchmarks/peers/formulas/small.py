"""Equations of few components.

A formula is a function of a module `m` with sin and cos (math, numpy, jax.numpy, heyoka, symengine) and returns what
that program is given: ``field(t, x, p)``, a tuple of components, and ``jacobian(t, x, p)``, a tuple of rows.
"""

from math import pi, sin


def lorenz(m):
    def field(t, x, p):
        sigma, beta, rho = p
        return (sigma * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - beta * x[2])

    return field


def lorenz_jacobian(m):
    def jacobian(t, x, p):
        sigma, beta, rho = p
        return ((-sigma, sigma, 0.0), (rho - x[2], -1.0, -x[0]), (x[1], x[0], -beta))

    return jacobian


def henon_map(m):
    def rule(t, x, p):
        a, b = p
        return (1.0 - a * x[0] * x[0] + x[1], b * x[0])

    return rule


def henon_map_jacobian(m):
    def jacobian(t, x, p):
        a, b = p
        return ((-2.0 * a * x[0], 1.0), (b, 0.0))

    return jacobian


def henon_map_before(x, p):
    """The point whose image is x."""
    a, b = p
    before = x[1] / b
    return (before, x[0] - 1.0 + a * before * before)


def oscillator(m):
    """It flies between impacts."""

    def field(t, x, p):
        zeta, omega = p
        return (x[1], m.cos(omega * t) - 2.0 * zeta * x[1] - x[0])

    return field


def oscillator_jacobian(m):
    def jacobian(t, x, p):
        zeta, omega = p
        return ((0.0, 1.0), (-1.0, -2.0 * zeta))

    return jacobian


def rossler(m):
    def field(t, x, p):
        a, b, c = p
        return (-x[1] - x[2], x[0] + a * x[1], b + x[2] * (x[0] - c))

    return field


def rossler_jacobian(m):
    def jacobian(t, x, p):
        a, b, c = p
        return ((0.0, -1.0, -1.0), (1.0, a, 0.0), (x[2], 0.0, x[0] - c))

    return jacobian


def henon_heiles(m):
    """x is (q_1, q_2, p_1, p_2)."""

    def field(t, x, p):
        return (x[2], x[3], -x[0] - 2.0 * x[0] * x[1], -x[1] - x[0] * x[0] + x[1] * x[1])

    return field


def henon_heiles_jacobian(m):
    def jacobian(t, x, p):
        return (
            (0.0, 0.0, 1.0, 0.0),
            (0.0, 0.0, 0.0, 1.0),
            (-1.0 - 2.0 * x[1], -2.0 * x[0], 0.0, 0.0),
            (-2.0 * x[0], -1.0 + 2.0 * x[1], 0.0, 0.0),
        )

    return jacobian


def henon_heiles_potential(m):
    def potential(q, p):
        return (q[0] ** 2 + q[1] ** 2) / 2 + q[0] ** 2 * q[1] - q[1] ** 3 / 3

    return potential


def standard_map(m):
    """Chirikov's map with angle and momentum in turns."""

    def rule(t, x, p):
        (kick,) = p
        momentum = x[1] + kick / (2.0 * pi) * m.sin(2.0 * pi * x[0])
        return ((x[0] + momentum) % 1.0, momentum % 1.0)

    return rule


def standard_map_jacobian(m):
    def jacobian(t, x, p):
        (kick,) = p
        turned = kick * m.cos(2.0 * pi * x[0])
        return ((1.0 + turned, 1.0), (turned, 1.0))

    return jacobian


def standard_map_before(x, p):
    """The point whose image is x."""
    (kick,) = p
    angle = (x[0] - x[1]) % 1.0
    return (angle, (x[1] - kick / (2.0 * pi) * sin(2.0 * pi * angle)) % 1.0)


def oregonator(m):
    """R. J. Field & R. M. Noyes, J. Chem. Phys. 60 (1974) 1877, doi:10.1063/1.1681288."""

    def field(t, x, p):
        s, q, w = p
        return (s * (x[1] - x[0] * x[1] + x[0] - q * x[0] * x[0]), (x[2] - x[1] - x[0] * x[1]) / s, w * (x[0] - x[2]))

    return field


def oregonator_jacobian(m):
    def jacobian(t, x, p):
        s, q, w = p
        first = (s * (1.0 - x[1] - 2.0 * q * x[0]), s * (1.0 - x[0]), 0.0)
        return (first, (-x[1] / s, (-1.0 - x[0]) / s, 1.0 / s), (w, 0.0, -w))

    return jacobian


def friction_pendulum(m):
    """With the sign of the velocity as the last parameter."""

    def field(t, x, p):
        beta, alpha, stiffness, amplitude, omega, sign = p
        drive = amplitude * m.sin(omega * t)
        return (x[1], drive - beta * x[1] - stiffness * m.sin(x[0]) - sign * alpha)

    return field


def friction_pendulum_jacobian(m):
    def jacobian(t, x, p):
        beta, alpha, stiffness, amplitude, omega, sign = p
        return ((0.0, 1.0), (-stiffness * m.cos(x[0]), -beta))

    return jacobian
