"""Models of convection, of the atmosphere and of dynamos: the Lorenz equations and their relatives."""

import jax.numpy as jnp

from ..spectra import Known
from ..table import published
from .sources import BOOK

LORENZ_84 = "E. N. Lorenz, Irregularity: a fundamental property of the atmosphere, Tellus A 36 (1984) 98"
TUWANKOTTA = "J. M. Tuwankotta, Chaos in a coupled oscillators system with widely spaced frequencies and "
TUWANKOTTA += "energy-preserving non-linearity, Int. J. Non-Linear Mech. 41 (2006) 180, "
TUWANKOTTA += "doi:10.1016/j.ijnonlinmec.2005.02.007"


@published(
    start=(11.35, 20.36, 16.15),
    turn=0.75,
    source="J. C. Sprott & A. Xiong, Classifying and quantifying basins of attraction, Chaos 25 (2015) 083101, "
    "doi:10.1063/1.4927643",
)
def lorenz_bounded(x, y, z, *, sigma=10.0, rho=28.0, beta=2.667, radius=64.0):
    """The Lorenz equations times 1 − |x|²/r², so that no orbit inside the sphere leaves it."""
    inside = 1 - (x**2 + y**2 + z**2) / radius**2
    return sigma * (y - x) * inside, (x * (rho - z) - y) * inside, (x * y - beta * z) * inside


@published(
    start=(-6.686, -2.09, 35.84, -2.861, -0.8653, 0.8856),
    turn=0.75,
    source="E. N. Lorenz, Deterministic nonperiodic flow, J. Atmos. Sci. 20 (1963) 130, "
    "doi:10.1175/1520-0469(1963)020<0130:DNF>2.0.CO;2; the coupling as in the dysts collection",
)
def lorenz_coupled(x, y, z, u, v, w, *, sigma=10.0, beta=2.667, rho1=35.0, rho2=1.15, coupling=2.85):
    """A chaotic Lorenz system that drives one which would rest."""
    drive = sigma * (y - x), x * (rho1 - z) - y, x * y - beta * z
    return *drive, sigma * (v - u) + coupling * (x - u), u * (rho2 - w) - v, u * v - beta * w


@published(
    start=(15.12, -1.865, -4.329, 1.061),
    turn=2.2,
    source="E. N. Lorenz, Predictability: a problem partly solved, ECMWF Seminar on Predictability 1 (1996) 1; "
    "four sites and F = 20 as in the dysts collection",
)
def lorenz96_four_sites(*x, forcing=20.0):
    """Lorenz' ring of sites on a circle of latitude, with four sites."""
    n = len(x)
    return tuple((x[(i + 1) % n] - x[i - 2]) * x[i - 1] - x[i] + forcing for i in range(n))


def _general_circulation(x, y, z, a, b, f, g):
    return -(y**2) - z**2 - a * (x - f), x * y - b * x * z - y + g, b * x * y + x * z - z


@published(
    start=(1.916, -0.8063, -2.117),
    turn=0.8,
    source=f"{LORENZ_84}, doi:10.3402/tellusa.v36i2.11473; parameters as in the dysts collection",
)
def lorenz84(x, y, z, *, a=1.32, b=7.91, f=4.83, g=4.194):
    """The general circulation of the atmosphere: the westerly wind and a wave of two phases."""
    return _general_circulation(x, y, z, a, b, f, g)


@published(
    start=(1.492, -0.4017, 1.198),
    turn=1.5,
    source=f"{LORENZ_84}, doi:10.3402/tellusa.v36i2.11473; parameters as in the dysts collection",
)
def hadley(x, y, z, *, a=0.2, b=4.0, f=9.0, g=1.0):
    """The same model of the general circulation; with these parameters it is known as Hadley's."""
    return _general_circulation(x, y, z, a, b, f, g)


@published(
    start=(-0.2574, 0.2783, 1.075),
    turn=6.0,
    source="T. Shimizu & N. Morioka, On the bifurcation of a symmetric limit cycle to an asymmetric one in a simple "
    "model, Phys. Lett. A 76 (1980) 201, doi:10.1016/0375-9601(80)90466-1; parameters as in the dysts collection "
    "(often a = 0.75, b = 0.45)",
)
def shimizu_morioka(x, y, z, *, a=0.85, b=0.5):
    """A simplified Lorenz model near a symmetric homoclinic orbit."""
    return y, x - a * y - x * z, -b * z + x**2


@published(
    start=(-2.128, 1.446, 7.384),
    turn=2.6,
    source="A. M. Rucklidge, Chaos in models of double convection, J. Fluid Mech. 237 (1992) 209, "
    "doi:10.1017/S0022112092003392",
    known=Known((0.0643,), 5e-5, f"{BOOK} A.5.15"),
    note="The published λ₁ is a third of ours. Both methods, all starts, a run from the book's own start (0.195(3)) "
    "and the estimate of the dysts collection (0.194) agree with ours.",
)
def rucklidge(x, y, z, *, a=2.0, b=6.7):
    """Double convection in a magnetic field."""
    return -a * x + b * y - y * z, x, -z + y**2


@published(
    start=(0.1191, 3.127, 3.093),
    turn=1.3,
    source="D. W. Moore & E. A. Spiegel, A thermally excited non-linear oscillator, Astrophys. J. 143 (1966) 871, "
    "doi:10.1086/148562; parameters as in the dysts collection",
)
def moore_spiegel(x, y, z, *, a=10.0, b=4.0, epsilon=9.0):
    """A thermally excited oscillator, a parcel of fluid in a star."""
    return y, a * z, -z + epsilon * y - y * x**2 - b * x


@published(
    start=(8.475, 4.227, 23.73),
    turn=0.5,
    source="T. Yanagita & K. Kaneko, Rayleigh–Bénard convection: patterns, chaos, spatiotemporal chaos and "
    "turbulence, Physica D 82 (1995) 288, doi:10.1016/0167-2789(94)00233-G; three modes as in the dysts collection",
)
def rayleigh_benard(x, y, z, *, a=30.0, b=5.0, r=18.0):
    """Three modes of Rayleigh–Bénard convection without damping of the second one."""
    return a * (y - x), r * y - x * z, x * y - b * z


@published(
    start=(-8.061, -0.4337, 0.02542),
    turn=1.1,
    source="G. K. Vallis, Conceptual models of El Niño and the Southern Oscillation, J. Geophys. Res. 93 (1988) "
    "13979, doi:10.1029/JC093iC11p13979",
)
def vallis_el_nino(x, y, z, *, b=102.0, c=3.0, p=0.0):
    """The current at the equator and the temperatures of the ocean on both sides."""
    return b * y - c * (x + p), -y + x * z, -z - x * y + 1


@published(start=(0.0008402, -0.05149, 0.6167), turn=2.0, source=TUWANKOTTA)
def atmospheric_regime(x, y, z, *, alpha=-2.0, beta=-5.0, mu1=0.05, mu2=-0.01, omega=3.0, sigma=1.1):
    """Two coupled oscillators of widely spaced frequencies, an ultra-low-frequency model of the atmosphere."""
    dy = mu2 * y + omega * z + alpha * y * z + beta * z**2 - sigma * x**2
    return mu1 * x + sigma * x * y, dy, mu2 * z - omega * y - alpha * y**2 - beta * y * z


@published(
    start=(0.6542, 4.467, 95.13),
    turn=3.0,
    source="J. P. Smith, J.-L. Thiffeault & W. Horton, J. Geophys. Res. 105 (2000) 12983, doi:10.1029/1999JA000218; "
    "W. Horton, R. S. Weigel & J. C. Sprott, Phys. Plasmas 8 (2001) 2946, doi:10.1063/1.1371522; form and parameters "
    "as in the dysts collection",
    note="the switch tanh(d (i − 1)) is steep: nearly a jump of the field",
)
def windmi_reduced(i, v, p, *, a1=0.247, b1=10.8, b2=0.0752, b3=1.06, d1=2200.0, wind=5.0):
    """A substorm of the magnetosphere: current, voltage and pressure under a solar wind."""
    unloading = p**1.25 * jnp.sqrt(wind) * (1 + jnp.tanh(d1 * (i - 1))) / 2
    return a1 * (wind - v), b1 * i - b2 * p / 2 - b3 * v, wind**2 - unloading


@published(
    start=(1.006, 0.8154, 3.056),
    turn=3.0,
    source="T. Rikitake, Oscillations of a system of disk dynamos, Math. Proc. Camb. Philos. Soc. 54 (1958) 89, "
    "doi:10.1017/S0305004100033223",
)
def rikitake(x, y, z, *, a=1.0, mu=1.0):
    """Two coupled disk dynamos whose currents reverse, as the magnetic field of the earth does."""
    return -mu * x + y * z, -mu * y + x * (z - a), 1 - x * y


@published(
    start=(0.6357, 1.466, 18.46, 0.8463),
    turn=1.0,
    source="L. Stenflo, Generalized Lorenz equations for acoustic-gravity waves in the atmosphere, Phys. Scr. 53 "
    "(1996) 83, doi:10.1088/0031-8949/53/1/015; C. Letellier & O. E. Rössler, Hyperchaos, Scholarpedia 2 (2007) 1936, "
    "doi:10.4249/scholarpedia.1936; parameters as in the dysts collection",
)
def lorenz_stenflo(x, y, z, w, *, a=2.0, b=0.7, c=26.0, d=1.5):
    """Acoustic-gravity waves in a rotating atmosphere."""
    return a * (y - x) + d * w, x * (c - z) - y, x * y - b * z, -x - a * w


@published(
    start=(1.193, -1.162, -0.05764),
    turn=0.8,
    source="R. Shaw, Strange attractors, chaotic behavior and information flow, Z. Naturforsch. A 36 (1981) 80, "
    "p. 104, doi:10.1515/zna-1981-0115; the dysts collection writes + y in the second equation instead of − y",
    known=Known((2.2499, 0.0, -13.2499), 5e-5, f"{BOOK} A.5.14, where the sign of s x y is a misprint"),
)
def burke_shaw(x, y, z, *, s=10.0, v=13.0):
    """A system of the Lorenz type with another symmetry, by W. Burke and R. Shaw."""
    return -s * (x + y), -y - s * x * z, s * x * y + v


@published(
    start=(9.32, 3.105, 31.45),
    turn=0.4,
    source="G. Chen & T. Ueta, Yet another chaotic attractor, Int. J. Bifurcation Chaos 9 (1999) 1465, "
    "doi:10.1142/S0218127499001024",
    known=Known((2.0272, 0.0, -12.0272), 5e-5, f"{BOOK} A.5.5"),
)
def chen(x, y, z, *, a=35.0, b=3.0, c=28.0):
    """Chen's system, dual to that of Lorenz."""
    return a * (y - x), x * (c - a - z) + c * y, x * y - b * z


@published(
    start=(15.13, 15.56, 22.78),
    turn=0.5,
    source="J. Lü & G. Chen, A new chaotic attractor coined, Int. J. Bifurcation Chaos 12 (2002) 659, "
    "doi:10.1142/S0218127402004620; c as in the dysts collection (often 20)",
)
def lu_chen(x, y, z, *, a=36.0, b=3.0, c=18.0):
    """Lü's system, between those of Lorenz and of Chen."""
    return a * (y - x), -x * z + c * y, x * y - b * z


@published(
    start=(5.38, 0.5568, 1.679),
    turn=0.9,
    source="J. Lü, G. Chen & D. Cheng, A new chaotic system and beyond: the generalized Lorenz-like system, Int. J. "
    "Bifurcation Chaos 14 (2004) 1507, doi:10.1142/S021812740401014X",
)
def lu_chen_cheng(x, y, z, *, a=-10.0, b=-4.0, c=18.1):
    """A system with two double scrolls at once."""
    return -a * b / (a + b) * x - y * z + c, a * y + x * z, b * z + x * y


@published(
    start=(-9.025, 6.84, 89.87),
    turn=0.4,
    source="G. Qi, G. Chen, M. A. van Wyk, B. J. van Wyk & Y. Zhang, A four-wing chaotic attractor generated from a "
    "new 3-D quadratic autonomous system, Chaos Solitons Fractals 38 (2008) 705; parameters as in the dysts collection",
)
def qi_chen(x, y, z, *, a=38.0, b=2.666, c=80.0):
    """A Lorenz-like system with a product in each equation."""
    return a * (y - x) + y * z, c * x + y - x * z, x * y - b * z
