"""Chaotic advection: paths of particles in flows of an incompressible fluid. Each field has no divergence."""

import math

import jax.numpy as jnp
import numpy as np

from ..table import published

STIFFNESS = 20.0  # how fast the protocols change over, as in the dysts collection
WAVES = np.array([0.313922, 0.627845, 0.941767])  # of the jet, per 1000 km
SPEEDS = np.array([9.05854e-6, 1.28453e-5, 2.88863e-5])  # of its waves, 1000 km per second
AMPLITUDES = np.array([0.0075, 0.15, 0.3])


def _protocol(t, tau):
    """Between −1 and 1, with period tau: which of two stirrers turns."""
    return jnp.tanh(STIFFNESS * tau * jnp.sin(2 * math.pi * t / tau))


@published(
    start=(0.71, 2.46, 3.25),
    turn=2.9,
    conservative=True,
    source="V. I. Arnold, Sur la topologie des écoulements stationnaires des fluides parfaits, C. R. Acad. Sci. 261 "
    "(1965) 17; T. Dombre et al., Chaotic streamlines in the ABC flows, J. Fluid Mech. 167 (1986) 353, "
    "doi:10.1017/S0022112086002859",
)
def abc(x, y, z, *, a=1.73205, b=1.41421, c=1.0):
    """Streamlines of the Arnold–Beltrami–Childress flow."""
    return (
        a * jnp.sin(z) + c * jnp.cos(y),
        b * jnp.sin(x) + a * jnp.cos(z),
        c * jnp.sin(y) + b * jnp.cos(x),
    )


@published(
    start=(1.0, 0.5),
    turn=10.0,
    conservative=True,
    source="S. C. Shadden, F. Lekien & J. E. Marsden, Definition and properties of Lagrangian coherent structures from "
    "finite-time Lyapunov exponents in two-dimensional aperiodic flows, Physica D 212 (2005) 271, "
    "doi:10.1016/j.physd.2005.10.007",
)
def double_gyre(t, x, y, *, alpha=0.1, eps=0.1, omega=0.62832):
    """Two gyres whose border moves to and fro."""
    shift = eps * jnp.sin(omega * t)
    f, slope = shift * x**2 + (1 - 2 * shift) * x, 2 * shift * x + 1 - 2 * shift
    speed = math.pi * alpha
    return (
        -speed * jnp.sin(math.pi * f) * jnp.cos(math.pi * y),
        speed * jnp.cos(math.pi * f) * jnp.sin(math.pi * y) * slope,
    )


@published(
    start=(3.142, 1.047),
    turn=12.8,
    conservative=True,
    source="T. H. Solomon & J. P. Gollub, Chaotic particle transport in time-dependent Rayleigh–Bénard convection, "
    "Phys. Rev. A 38 (1988) 6280, doi:10.1103/PhysRevA.38.6280; parameters as in the dysts collection",
)
def oscillating_flow(t, x, y, *, b=0.48, k=1.0, omega=0.49, u=0.72):
    """Convection rolls that oscillate sideways."""
    f = x + b * jnp.sin(omega * t)
    return u * jnp.cos(k * y) * jnp.sin(k * f), -u * jnp.sin(k * y) * jnp.cos(k * f)


@published(
    start=(0.3, -0.4),
    turn=1e5,
    conservative=True,
    source="A. Hadjighasem, D. Karrasch, H. Teramoto & G. Haller, Spectral-clustering approach to Lagrangian vortex "
    "detection, Phys. Rev. E 93 (2016) 063107, doi:10.1103/PhysRevE.93.063107",
)
def bickley_jet(t, x, y, *, width=1.77, u=6.266e-5):
    """A jet with three waves, as in the stratosphere; lengths in 1000 km, time in seconds."""
    phase, sech2 = WAVES * (x - SPEEDS * t), 1 / jnp.cosh(y / width) ** 2
    dx = u * sech2 * (-1 - 2 * jnp.sum(AMPLITUDES * jnp.cos(phase)) * jnp.tanh(y / width))
    return dx, width * u * sech2 * jnp.sum(AMPLITUDES * WAVES * jnp.sin(phase))


def _rotlet(x, y, a, b, wall):
    """Velocity by a rotlet (wall = 1) or a point vortex (0) at (b, 0) in a disk of radius a."""
    r2 = x**2 + y**2
    near = r2 + b**2 - 2 * b * x  # squared distance from the stirrer
    image = a**2 + b**2 * r2 / a**2 - 2 * b * x
    gamma = (1 - r2 / a**2) * (a**2 - b**2 * r2 / a**2)
    radial = b * y * (1 / near - 1 / image - wall * gamma / image**2)  # r times the radial velocity
    skew = b**2 * r2 / a**2 - b * x  # r times the quantity that stands on the line below
    swirl = wall * gamma * skew / image**2 + skew / image - (r2 - b * x) / near
    swirl = swirl + wall * r2 * (a**2 + b**2 - 2 * b**2 * r2 / a**2) / (a**2 * image)  # r times the other velocity
    return (radial * x - swirl * y) / r2, (radial * y + swirl * x) / r2


def _blinking(t, x, y, a, b, strength, tau, wall):
    right, left = _rotlet(x, y, a, b, wall), _rotlet(x, y, a, -b, wall)
    w = (1 + _protocol(t, tau)) / 2
    return tuple(strength * (w * one + (1 - w) * other) for one, other in zip(right, left, strict=True))


@published(
    start=(-0.0853, 0.0044),
    turn=3.0,
    conservative=True,
    source="V. V. Meleshko & H. Aref, A blinking rotlet model for chaotic advection, Phys. Fluids 8 (1996) 3215; "
    "protocol as in the dysts collection",
)
def blinking_rotlet(t, x, y, *, a=1.0, b=0.5298833894399929, strength=-1.0, tau=3.0):
    """Two rotlets in a disk of a viscous fluid that turn by turns."""
    return _blinking(t, x, y, a, b, strength, tau, 1.0)


@published(
    start=(-0.0853, 0.0044),
    turn=3.0,
    conservative=True,
    source="H. Aref, Stirring by chaotic advection, J. Fluid Mech. 143 (1984) 1, doi:10.1017/S0022112084001233; "
    "protocol as in the dysts collection",
)
def blinking_vortex(t, x, y, *, a=1.0, b=0.5, strength=-1.0, tau=3.0):
    """Two point vortices in a disk that turn by turns."""
    return _blinking(t, x, y, a, b, strength, tau, 0.0)


def _lid(x, y, m, speed, a, b):
    """Velocity in a cavity whose lids move as sin(m π x / a)."""
    q = m * math.pi / a
    scale = 2 * speed / (2 * m * math.pi * b + a * jnp.sinh(2 * q * b))
    s, c, sinh, cosh = jnp.sinh(q * b), jnp.cosh(q * b), jnp.sinh(q * y), jnp.cosh(q * y)
    dx = -m * math.pi * b * s * sinh + c * (m * math.pi * y * cosh + a * sinh)
    return scale * jnp.sin(q * x) * dx, scale * m * math.pi * jnp.cos(q * x) * (b * s * cosh - c * y * sinh)


@published(
    start=(3.967, 0.1843),
    turn=1.1,
    conservative=True,
    source="P. Grover, S. D. Ross, M. A. Stremler & P. Kumar, Topological chaos, braiding and bifurcation of "
    "almost-cyclic sets, Chaos 22 (2012) 043135, doi:10.1063/1.4768666; protocol as in the dysts collection",
)
def lid_driven_cavity(t, x, y, *, tau=1.1, u1=9.92786, u2=8.34932, a=6.0, b=1.0):
    """A cavity whose lids drive the left and the right half by turns."""
    one, two = _lid(x, y, 1, u1, a, b), _lid(x, y, 2, u2, a, b)
    w = _protocol(t, tau)
    return w * one[0] + two[0], w * one[1] + two[1]


@published(
    start=(0.0995, 0.00998),
    turn=3.0,
    conservative=True,
    source="J. R. Blake, Self propulsion due to oscillations on the surface of a cylinder at low Reynolds number, "
    "Bull. Aust. Math. Soc. 5 (1971) 255, doi:10.1017/S0004972700047134; protocol as in the dysts collection",
)
def interior_squirmer(t, x, y, *, tau=3.0, sine=0.5, cosine=0.5):
    """A drop inside which a moving surface drives five modes, sines and cosines by turns."""
    w = (1 + _protocol(t, tau)) / 2
    a, g, r2 = sine * w, cosine * (1 - w), x**2 + y**2
    radial, swirl, c, s = 0.0, 0.0, x, y  # c + i s = (x + i y)^n
    for n in range(1, 6):
        radial = radial + (g * c + a * s) * n * (r2 - 1)
        swirl = swirl + (a * c - g * s) * (2 * r2 + (r2 - 1) * n)
        c, s = x * c - y * s, x * s + y * c
    return (radial * x - swirl * y) / r2, (radial * y + swirl * x) / r2
