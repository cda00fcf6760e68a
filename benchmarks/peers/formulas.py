"""The equations, each once, for every program.

A formula is a function of a module `m` with sin and cos (math, numpy, jax.numpy, heyoka, symengine) and returns what
that program is given: ``field(t, x, p)``, a tuple of components, and ``jacobian(t, x, p)``, a tuple of rows.
"""


def lorenz(m):
    def field(t, x, p):
        sigma, rho, beta = p
        return (sigma * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - beta * x[2])

    return field


def lorenz_jacobian(m):
    def jacobian(t, x, p):
        sigma, rho, beta = p
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
    def field(t, x, p):
        zeta, omega, restitution = p
        return (x[1], m.cos(omega * t) - 2.0 * zeta * x[1] - x[0])

    return field


def oscillator_jacobian(m):
    def jacobian(t, x, p):
        zeta, omega, restitution = p
        return ((0.0, 1.0), (-1.0, -2.0 * zeta))

    return jacobian
