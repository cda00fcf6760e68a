"""Chemical reactions."""

import jax.numpy as jnp

from ..table import published


@published(
    start=(0.4912, 1.822, 0.8486),
    turn=0.038,
    source="L. Györgyi & R. J. Field, A three-variable model of deterministic chaos in the Belousov–Zhabotinsky "
    "reaction, Nature 355 (1992) 808, doi:10.1038/355808a0",
)
def belousov_zhabotinsky(x, z, v, *, kf=0.00035, ci=0.000833):
    """The Belousov–Zhabotinsky reaction in a stirred flow: three scaled concentrations; time in units of 2308.62 s."""
    y = 6.92813e-7 / 7.72571e-6 * z * v / (2.00869 * x + 0.01352 + kf)
    radical = (ci - 8.33e-6 * z) * jnp.sqrt(jnp.maximum(x, 0.0))
    dx = -8.03474 * x * y + 0.05408 * y - 0.0115886 * x**2 + 832.587 * radical - 0.029155 * x * z - kf * x
    dz = 0.00321617 / 8.33e-6 * radical - 0.01352 * x * z - 0.0831709 * z * v - 0.0199985 * z - kf * z
    dv = 0.0223915 * x * y + 7.53559e-5 * y + 8.07384e-6 * x**2 - 0.000499825 * z * v - kf * v
    return 2308.62 * dx, 2308.62 * dz, 2308.62 * dv


@published(
    start=(0.4099, 1.413, 1.102),
    turn=0.73,
    source="V. Petrov, S. K. Scott & K. Showalter, Mixed-mode oscillations in chemical systems, J. Chem. Phys. 97 "
    "(1992) 6191, doi:10.1063/1.463727",
)
def isothermal_chemical(a, b, c, *, delta=1.0, kappa=2.5, mu=0.29786, sigma=0.013):
    """Three autocatalysts of an isothermal reaction."""
    made = a * b**2 + a
    return mu * (kappa + c) - made, (made - b) / sigma, (b - c) / delta


@published(
    start=(-1.025, 4.927, -1.12),
    turn=11.0,
    source="P. E. Strizhak & A. L. Kawczynski, J. Phys. Chem. 99 (1995) 10830, doi:10.1021/j100027a024; form and "
    "parameters as in the dysts collection",
)
def kawczynski_strizhak(x, y, z, *, beta=-0.4, gamma=0.49, kappa=0.2, mu=2.1):
    """A simple model of complex oscillations of a reaction."""
    return gamma * (y - x**3 + 3 * mu * x), -2 * mu * x - y - z + beta, kappa * (x - z)


@published(
    start=(0.4064, 1.819),
    turn=7.76,
    source="K. Tomita & T. Kai, Stroboscopic phase portrait and strange attractors, Phys. Lett. A 66 (1978) 91; "
    "I. Prigogine, From Being to Becoming, Freeman (1980); form and parameters as in the dysts collection",
)
def forced_brusselator(t, x, y, *, a=0.4, b=1.2, force=0.05, omega=0.81):
    """The Brusselator under a periodic feed."""
    return a + x**2 * y - (b + 1) * x + force * jnp.cos(omega * t), b * x - x**2 * y
