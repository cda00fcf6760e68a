"""Mechanics: forced and coupled oscillators."""

import math

import jax.numpy as jnp

from ..table import published


@published(
    start=(-1.164, -0.5092),
    turn=4.5,
    source="G. Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz und ihre technische Bedeutung, "
    "Vieweg (1918); parameters as in the dysts collection",
)
def duffing(t, x, v, *, alpha=1.0, beta=-1.0, delta=0.1, gamma=0.35, omega=1.4):
    """A buckled beam under a periodic force."""
    return v, -delta * v - beta * x - alpha * x**3 + gamma * jnp.cos(omega * t)


@published(
    start=(0.1133, 1.571, 0.1099, 0.1775),
    turn=0.34,
    conservative=True,
    source="N. B. Tufillaro, T. A. Abbott & D. J. Griffiths, Swinging Atwood's machine, Am. J. Phys. 52 (1984) 895, "
    "doi:10.1119/1.13791; masses and start as in the dysts collection",
)
def swinging_atwood(r, theta, pr, ptheta, *, m1=1.0, m2=4.5, g=9.82):
    """Atwood's machine one weight of which swings."""
    dpr = ptheta**2 / (m1 * r**3) - m2 * g + m1 * g * jnp.cos(theta)
    return pr / (m1 + m2), ptheta / (m1 * r**2), dpr, -m1 * g * r * jnp.sin(theta)


@published(
    start=(0.1047, 0.08929, 0.0, 0.0),
    turn=67.0,
    conservative=True,
    source="C. Froeschlé, M. Guzzo & E. Lega, Graphical evolution of the Arnold web: from order to chaos, Science 289 "
    "(2000) 2108, doi:10.1126/science.289.5487.2108",
)
def arnold_web(t, p1, p2, q1, q2, *, mu=0.01, omega=1.0):
    """Two rotators and a clock, coupled weakly: the web of resonances."""
    weight = mu / (4 + jnp.cos(omega * t) + jnp.cos(q1) + jnp.cos(q2)) ** 2
    return -weight * jnp.sin(q1), -weight * jnp.sin(q2), p1, p2


@published(
    start=(-0.8559, 1.481, -0.8508, 1.636),
    turn=6.0,
    conservative=True,
    source="V. Baran & A. A. Raduta, Int. J. Mod. Phys. E 7 (1998) 527; form and parameters as in the dysts collection",
)
def nuclear_quadrupole(q1, q2, p1, p2, *, a=1.0, b=0.55, d=0.4):
    """Quadrupole vibrations of a nucleus, a quartic Hénon–Heiles system."""
    r2 = q1**2 + q2**2
    dp1 = -a * q1 + 3 / math.sqrt(2) * b * (q1**2 - q2**2) - d * q1 * r2
    return a * p1, a * p2, dp1, -a * q2 - 3 * math.sqrt(2) * b * q1 * q2 - d * q2 * r2
