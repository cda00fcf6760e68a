"""Autonomous flows in three dimensions, most of them polynomial: scrolls, wings, bands and tori."""

import jax.numpy as jnp

from ..spectra import Known
from ..table import published
from .sources import BOOK

CUBIC_JERK = (
    "form and parameters as in the dysts collection, which cites A. Arneodo, P. Coullet & C. Tresser, Occurence of "
    "strange attractors in three-dimensional Volterra equations, Phys. Lett. A 79 (1980) 259, "
    "doi:10.1016/0375-9601(80)90342-4; see also P. Coullet, C. Tresser & A. Arneodo, Transition to stochasticity for a "
    "class of forced oscillators, Phys. Lett. A 72 (1979) 268, doi:10.1016/0375-9601(79)90464-X"
)
FEEDBACK = "R. Thomas, Deterministic chaos seen in terms of feedback circuits: analysis, synthesis, “labyrinth "
FEEDBACK += (
    "chaos”, Int. J. Bifurcation Chaos 9 (1999) 1889, doi:10.1142/S0218127499001383; parameters as in the dysts "
)
FEEDBACK += "collection"
CYCLES = "S. Bouali, Feedback loop in extended van der Pol's equation applied to an economic model of cycles, Int. J. "
CYCLES += (
    "Bifurcation Chaos 9 (1999) 745, doi:10.1142/S0218127499000535; form and parameters as in the dysts collection"
)


@published(start=(-2.115, -2.506, -2.512), turn=2.5, source=FEEDBACK)
def thomas(x, y, z, *, a=1.85, b=10.0):
    """Thomas' cyclically symmetric flow, the same in all three directions."""
    return -a * x + b * jnp.sin(y), -a * y + b * jnp.sin(z), -a * z + b * jnp.sin(x)


@published(start=(-3.747, -3.298, 2.109), turn=3.0, source=FEEDBACK)
def thomas_labyrinth(x, y, z, *, a=0.5, b=10.0):
    """Thomas' flow with weak damping: a walk through a labyrinth of unstable points."""
    return thomas(x, y, z, a=a, b=b)


@published(
    start=(3.019, -7.637, -4.591),
    turn=1.5,
    source="A. Halvorsen, unpublished; J. C. Sprott, Elegant Chaos, World Scientific (2010), doi:10.1142/7183; "
    "parameters as in the dysts collection",
)
def halvorsen(x, y, z, *, a=1.4, b=4.0):
    """Halvorsen's cyclically symmetric flow."""
    return -a * x - b * (y + z) - y**2, -a * y - b * (z + x) - z**2, -a * z - b * (x + y) - x**2


def _cubic_jerk(x, y, z, a, b, c, d):
    return y, z, -a * x - b * y - c * z + d * x**3


@published(start=(-2.44, 1.517, 2.897), turn=3.2, source=f"{CUBIC_JERK}; other collections have b = 3.5")
def arneodo(x, y, z, *, a=-5.5, b=4.5, c=1.0, d=-1.0):
    """A cubic jerk equation with two spirals."""
    return _cubic_jerk(x, y, z, a, b, c, d)


@published(start=(0.3454, 0.4285, 0.08698), turn=5.8, source=CUBIC_JERK)
def coullet(x, y, z, *, a=-0.8, b=1.1, c=0.45, d=-1.0):
    """The same cubic jerk equation after a cascade of doublings."""
    return _cubic_jerk(x, y, z, a, b, c, d)


@published(
    start=(0.05811, 0.529, 0.2046),
    turn=6.0,
    source="R. Genesio & A. Tesi, Harmonic balance methods for the analysis of chaotic dynamics in nonlinear systems, "
    "Automatica 28 (1992) 531, doi:10.1016/0005-1098(92)90177-H",
)
def genesio_tesi(x, y, z, *, a=0.44, b=1.1, c=1.0):
    """A quadratic jerk equation."""
    return y, z, -c * x - b * y - a * z + x**2


@published(
    start=(-0.3866, 1.76, 1.021),
    turn=2.3,
    source="M. I. Rabinovich & A. L. Fabrikant, Stochastic self-modulation of waves in nonequilibrium media, Sov. "
    "Phys. JETP 50 (1979) 311; parameters as in Sprott, Chaos and Time-Series Analysis, Oxford (2003)",
    known=Known((0.1981, 0.0, -0.6581), 5e-5, f"{BOOK} A.5.8"),
)
def rabinovich_fabrikant(x, y, z, *, a=1.1, g=0.87):
    """Waves that modulate themselves in a plasma."""
    return y * (z - 1 + x**2) + g * x, x * (3 * z + 1 - x**2) + g * y, -2 * z * (a + x * y)


@published(
    start=(-0.5579, 0.07206, -0.5789),
    turn=0.31,
    source="J. Guckenheimer & P. Holmes, Nonlinear Oscillations, Dynamical Systems, and Bifurcations of Vector Fields, "
    "Springer (1983), doi:10.1007/978-1-4612-1140-2; form and parameters as in the dysts collection",
)
def guckenheimer_holmes(x, y, z, *, a=0.4, b=20.25, c=3.0, d=1.6, e=1.7, f=0.44):
    """An unfolding of a point with a zero and a pair of imaginary eigenvalues."""
    r2 = x**2 + y**2
    return a * x - b * y + c * z * x + d * z * r2, a * y + b * x + c * z * y, e - z**2 - f * r2 - a * z**3


@published(
    start=(-0.7611, 0.4804, 1.611),
    turn=1.8,
    source="W. F. Langford, Numerical studies of torus bifurcations, in: Numerical Methods for Bifurcation Problems, "
    "Birkhäuser (1984) 285, doi:10.1007/978-3-0348-6256-1_19",
)
def aizawa(x, y, z, *, a=0.95, b=0.7, c=0.6, d=3.5, e=0.25, f=0.1):
    """Langford's flow near a torus, often named after Aizawa."""
    dz = c + a * z - z**3 / 3 - (x**2 + y**2) * (1 + e * z) + f * z * x**3
    return x * (z - b) - d * y, d * x + y * (z - b), dz


@published(
    start=(0.3481, -0.02526, 0.1324),
    turn=4.0,
    source="R. B. Leipnik & T. A. Newton, Double strange attractors in rigid body motion with linear feedback control, "
    "Phys. Lett. A 86 (1981) 63, doi:10.1016/0375-9601(81)90165-1",
)
def newton_leipnik(x, y, z, *, a=0.4, b=0.175):
    """A rigid body with linear feedback; two strange attractors."""
    return -a * x + y + 10 * y * z, -x - 0.4 * y + 5 * x * z, b * z - 5 * x * y


@published(
    start=(2.531, -0.1463, 0.03799),
    turn=0.9,
    source="T. Zhou & G. Chen, A simple smooth chaotic system with a 3-layer attractor, Int. J. Bifurcation Chaos 14 "
    "(2004) 1795, doi:10.1142/S0218127404010175",
)
def zhou_chen(x, y, z, *, a=2.97, b=0.15, c=-3.0, d=1.0, e=-8.78):
    """An attractor of three layers."""
    return a * x + b * y + y * z, c * y - x * z + d * y * z, e * z - x * y


@published(
    start=(-0.7332, -0.2905, 4.955),
    turn=2.8,
    source="H.-K. Chen & C.-I. Lee, Anti-control of chaos in rigid body motion, Chaos Solitons Fractals 21 (2004) 957, "
    "doi:10.1016/j.chaos.2003.12.034",
)
def chen_lee(x, y, z, *, a=5.0, b=-10.0, c=-0.38):
    """A rigid body, made chaotic by feedback."""
    return a * x - y * z, b * y + x * z, c * z + x * y / 3


@published(
    start=(-0.7539, 0.5157, 0.3467),
    turn=10.0,
    source="Z. Wang, Y. Sun, B. J. van Wyk, G. Qi & M. A. van Wyk, A 3-D four-wing attractor and its analysis, Braz. "
    "J. Phys. 39 (2009) 547, doi:10.1590/S0103-97332009000500007",
)
def wang_sun(x, y, z, *, a=0.2, b=-0.01, d=-0.4, e=-1.0, f=-1.0, q=1.0):
    """An attractor of four wings."""
    return a * x + q * y * z, b * x + d * y - x * z, e * z + f * x * y


@published(
    start=(4.672, 1e-3, -1e-3),
    turn=8.0,
    source="W. Liu & G. Chen, Can a three-dimensional smooth autonomous quadratic chaotic system generate a single "
    "four-scroll attractor?, Int. J. Bifurcation Chaos 14 (2004) 1395, doi:10.1142/S0218127404009880; form and "
    "parameters as in the dysts collection",
    note="orbits come within 1e-14 of the x axis, which is invariant, and stay near it for long times",
)
def liu_chen(x, y, z, *, a=0.4, b=12.0, c=-5.0):
    """A quadratic flow with products in all three equations."""
    return a * x + y * z, -b * y - x * z, c * z - x * y


@published(
    start=(10.84, -1.744, -3.017),
    turn=5.0,
    source="form and parameters as in the dysts collection, which cites C. Li, I. Pehlivan, J. C. Sprott & A. Akgul, A "
    "novel four-wing strange attractor born in bistability, IEICE Electron. Express 12 (2015) 20141116, "
    "doi:10.1587/elex.12.20141116; PredefinedDynamicalSystems.jl has another flow for that paper",
)
def sakarya(x, y, z, *, p=0.4, q=0.3):
    """A flow with a product in each equation."""
    return -x + y + y * z, -x - y + p * x * z, z - q * x * y


@published(
    start=(5.186, -0.8403, 0.9469),
    turn=1.0,
    source="S. Dadras & H. R. Momeni, A novel three-dimensional autonomous chaotic system generating two, three and "
    "four-scroll attractors, Phys. Lett. A 373 (2009) 3637, doi:10.1016/j.physleta.2009.07.088",
)
def dadras(x, y, z, *, p=3.0, o=2.7, r=1.7, c=2.0, e=9.0):
    """Attractors of two, three or four scrolls."""
    return y - p * x + o * y * z, r * y - x * z + z, c * x * y - e * z


@published(
    start=(0.2693, -0.8902, -3.801),
    turn=3.7,
    source="I. Pehlivan & Z. Wei, Analysis, nonlinear control, and chaos generator circuit of another strange chaotic "
    "system, Turk. J. Electr. Eng. Comput. Sci. 20 (2012) 1229, doi:10.3906/elk-1103-14",
)
def pehlivan_wei(x, y, z):
    """A quadratic flow without parameters."""
    return y - y * z, y + y * z - 2 * x, 2 - x * y - y**2


@published(
    start=(-0.4111, -0.8952, 0.5094),
    turn=4.0,
    source="W. San-Um & B. Srisuchinwong, Highly complex chaotic system with piecewise linear nonlinearity and "
    "compound structures, J. Comput. 7 (2012) 1041, doi:10.4304/jcp.7.4.1041-1047",
    note="|y| is a kink: the field is continuous, its derivative is not",
)
def san_um_srisuchinwong(x, y, z, *, a=2.0):
    """A flow with tanh and an absolute value."""
    return y - x, -z * jnp.tanh(x), -a + x * y + jnp.abs(y)


@published(
    start=(2.596, 1.767, -3.192),
    turn=0.9,
    source="A. Abooee, H. A. Yaghini-Bonabi & M. R. Jahed-Motlagh, Analysis and circuitry realization of a novel "
    "three-dimensional chaotic system, Commun. Nonlinear Sci. Numer. Simul. 18 (2013) 1235, "
    "doi:10.1016/j.cnsns.2012.08.036",
)
def laser(x, y, z, *, a=10.0, b=1.0, c=5.0, d=-1.0, h=-5.0, k=-6.0):
    """A cubic flow like the Lorenz–Haken equations of a laser."""
    return a * (y - x) + b * y * z**2, c * x + d * x * z**2, h * z + k * x**2


@published(
    start=(0.6728, -3.947, -0.1262),
    turn=6.0,
    source="G. Cai & J. Huang, A new finance chaotic attractor, Int. J. Nonlinear Sci. 3 (2007) 213; parameters as in "
    "the dysts collection",
)
def finance(x, y, z, *, a=0.001, b=0.2, c=1.1):
    """Interest rate, investment demand and price index."""
    return (1 / b - a) * x + z + x * y, -b * y - x**2, -x - c * z


def _business_cycle(x, y, z, a, b, bb, c, g, m, y0):
    return a * x * (y0 - y) - b * z, -g * y * (1 - x**2), -1.5 * m * x + m * bb * x * z - c * z


@published(start=(-0.5493, 4.486, 1.279), turn=3.0, source=CYCLES)
def bouali(x, y, z, *, a=1.0, b=-0.3, bb=1.0, c=0.05, g=1.0, m=1.0, y0=4.0):
    """A van der Pol equation with feedback, a model of business cycles."""
    return _business_cycle(x, y, z, a, b, bb, c, g, m, y0)


@published(start=(0.8429, 1.426, 0.05004), turn=10.0, source=CYCLES)
def bouali_weak(x, y, z, *, a=3.0, b=2.2, g=1.0, m=-0.0026667, y0=1.0):
    """The same with a weak and undamped feedback."""
    return _business_cycle(x, y, z, a, b, 0.0, 0.0, g, m, y0)


def _scrolls(x, y, z, a, c, d, eps, f, k):
    return a * (y - x) + d * x * z, k * x + f * y - x * z, c * z + x * y - eps * x**2


@published(
    start=(9.581, -124.0, 179.8),
    turn=2.0,
    source="D. Li, A three-scroll chaotic attractor, Phys. Lett. A 372 (2008) 387, doi:10.1016/j.physleta.2007.07.045",
)
def dequan_li(x, y, z, *, a=40.0, c=1.833, d=0.16, eps=0.65, f=20.0, k=55.0):
    """An attractor of three scrolls."""
    return _scrolls(x, y, z, a, c, d, eps, f, k)


@published(
    start=(-3.038, -1.981, 14.66),
    turn=0.75,
    source="W. Zhou, Y. Xu, H. Lu & L. Pan, On dynamics analysis of a new chaotic attractor, Phys. Lett. A 372 (2008) "
    "5773, doi:10.1016/j.physleta.2008.07.032",
)
def pan_xu_zhou(x, y, z, *, a=10.0, c=-2.6667, k=16.0):
    """A Lorenz equation without damping of the second component."""
    return _scrolls(x, y, z, a, c, 0.0, 0.0, 0.0, k)


@published(
    start=(-3.122, -2.435, 26.65),
    turn=3.0,
    source="L. Pan, W. Zhou, J. Fang & D. Li, A new three-scroll unified chaotic system coined, Int. J. Nonlinear Sci. "
    "10 (2010) 462; parameters as in the dysts collection, which cites a paper of 2013 on its synchronization",
)
def tsucs2(x, y, z, *, a=40.0, c=0.833, d=0.5, eps=0.65, f=20.0):
    """The second three-scroll unified chaotic system."""
    return _scrolls(x, y, z, a, c, d, eps, f, 0.0)


EXPONENTIAL = "F. Yu & C. Wang, A novel three dimension autonomous chaotic system with a quadratic exponential "
EXPONENTIAL += "nonlinear term, Eng. Technol. Appl. Sci. Res. 2 (2012) 209, doi:10.48084/etasr.86"


@published(start=(-2.13, -2.881, 27.38), turn=1.0, source=EXPONENTIAL)
def yu_wang(x, y, z, *, a=10.0, b=40.0, c=2.0, d=2.5):
    """A flow with the exponential of a product."""
    return a * (y - x), x * (b - c * z), jnp.exp(x * y) - d * z


@published(start=(-0.6785, -1.044, 11.59), turn=0.8, source=EXPONENTIAL)
def yu_wang_cosh(x, y, z, *, a=10.0, b=30.0, c=2.0, d=2.5):
    """The same with a hyperbolic cosine."""
    return a * (y - x), x * (b - c * z), jnp.cosh(x * y) - d * z
