"""Flows found by searches for the algebraically simplest chaos: J. C. Sprott's cases, and jerk equations."""

import jax.numpy as jnp

from ..spectra import Known
from ..table import published
from .sources import BOOK

SEARCH = "J. C. Sprott, Some simple chaotic flows, Phys. Rev. E 50 (1994) R647, doi:10.1103/PhysRevE.50.R647"


# The values of all 19 cases were compared with a public transcription of the table.
def _case(largest: float, smallest: float) -> Known:
    return Known((largest, 0.0, smallest), 5e-4, SEARCH)


@published(start=(0.0, 5.0, 0.0), turn=6.4, source=SEARCH, conservative=True, known=_case(0.014, -0.014))
def sprott_a(x, y, z):
    """Case A: a conservative oscillator with a thermostat, the Nosé–Hoover equations."""
    return y, -x + y * z, 1 - y**2


@published(start=(0.5555, -0.2872, -0.3768), turn=11.0, source=SEARCH, known=_case(0.210, -1.210))
def sprott_b(x, y, z):
    """Case B."""
    return y * z, x - y, 1 - x * y


@published(start=(-0.2447, 1.013, -1.401), turn=8.9, source=SEARCH, known=_case(0.163, -1.163))
def sprott_c(x, y, z):
    """Case C."""
    return y * z, x - y, 1 - x**2


@published(start=(-2.248, 0.3879, 0.8704), turn=4.8, source=SEARCH, known=_case(0.103, -1.320))
def sprott_d(x, y, z):
    """Case D."""
    return -y, x + z, x * z + 3 * y**2


@published(start=(1.159, 0.6912, 0.02644), turn=7.6, source=SEARCH, known=_case(0.078, -1.078))
def sprott_e(x, y, z):
    """Case E."""
    return y * z, x**2 - y, 1 - 4 * x


@published(start=(1.093, -0.007494, 0.524), turn=6.4, source=SEARCH, known=_case(0.117, -0.617))
def sprott_f(x, y, z, *, a=0.5):
    """Case F."""
    return y + z, -x + a * y, x**2 - z


@published(start=(0.6546, -0.5812, -1.535), turn=8.7, source=SEARCH, known=_case(0.034, -0.634))
def sprott_g(x, y, z, *, a=0.4):
    """Case G."""
    return a * x + z, x * z - y, -x + y


@published(start=(-2.821, 2.023, -2.585), turn=6.7, source=SEARCH, known=_case(0.117, -0.617))
def sprott_h(x, y, z, *, a=0.5):
    """Case H."""
    return -y + z**2, x + a * y, x - z


@published(start=(-0.07461, -0.7877, 0.4508), turn=10.9, source=SEARCH, known=_case(0.012, -1.012))
def sprott_i(x, y, z, *, a=0.2):
    """Case I."""
    return -a * y, x + z, x + y**2 - z


@published(start=(3.339, -5.427, -11.62), turn=4.8, source=SEARCH, known=_case(0.076, -2.076))
def sprott_j(x, y, z):
    """Case J."""
    return 2 * z, -2 * y + z, -x + y + y**2


@published(start=(0.6238, 0.4215, 0.3813), turn=7.0, source=SEARCH, known=_case(0.038, -0.890))
def sprott_k(x, y, z, *, a=0.3):
    """Case K."""
    return x * y - z, x - y, x + a * z


@published(start=(-2.845, 13.77, -1.1), turn=6.7, source=SEARCH, known=_case(0.061, -1.061))
def sprott_l(x, y, z, *, a=0.9, b=3.9):
    """Case L."""
    return y + b * z, a * x**2 - y, 1 - x


@published(start=(0.6423, -0.5764, -0.5153), turn=5.4, source=SEARCH, known=_case(0.044, -1.044))
def sprott_m(x, y, z, *, a=1.7):
    """Case M."""
    return -z, -(x**2) - y, a + a * x + y


@published(start=(3.63, 3.02, 0.4335), turn=4.8, source=SEARCH, known=_case(0.076, -2.076))
def sprott_n(x, y, z):
    """Case N."""
    return -2 * y, x + z**2, 1 + y - 2 * z


@published(start=(0.008169, -0.01066, 0.5185), turn=9.8, source=SEARCH, known=_case(0.049, -0.319))
def sprott_o(x, y, z, *, a=2.7):
    """Case O."""
    return y, x - z, x + x * z + a * y


@published(start=(0.3769, -0.7975, 1.256), turn=5.3, source=SEARCH, known=_case(0.087, -0.481))
def sprott_p(x, y, z, *, a=2.7):
    """Case P."""
    return a * y + z, -x + y**2, x + y


@published(start=(-1.821, -3.297, -1.159), turn=4.8, source=SEARCH, known=_case(0.109, -0.609))
def sprott_q(x, y, z, *, a=3.1, b=0.5):
    """Case Q."""
    return -z, x - y, a * x + y**2 + b * z


@published(start=(-1.995, -1.304, -0.6012), turn=7.0, source=SEARCH, known=_case(0.062, -1.062))
def sprott_r(x, y, z, *, a=0.9, b=0.4):
    """Case R."""
    return a - y, b + z, x * y - z


@published(start=(0.8828, 0.3813, 1.518), turn=3.4, source=SEARCH, known=_case(0.188, -1.188))
def sprott_s(x, y, z):
    """Case S."""
    return -x - 4 * y, x + z**2, 1 + x


@published(
    start=(-0.8384, -0.3113, 0.4817),
    turn=6.5,
    source="J. C. Sprott, Simplest dissipative chaotic flow, Phys. Lett. A 228 (1997) 271, "
    "doi:10.1016/S0375-9601(97)00088-1",
    known=Known((0.0551, 0.0, -2.0721), 5e-5, f"{BOOK} A.5.17"),
)
def simplest_jerk(x, y, z, *, a=2.017):
    """The dissipative jerk equation x''' + a x'' − x'² + x = 0."""
    return y, z, -x + y**2 - a * z


@published(
    start=(-1.037, -1.033, 0.2262),
    turn=7.5,
    source="J. C. Sprott, A new chaotic jerk circuit, IEEE Trans. Circuits Syst. II 58 (2011) 240, "
    "doi:10.1109/TCSII.2011.2124490",
)
def jerk_circuit(x, y, z, *, current=1e-9, voltage=0.026):
    """A jerk circuit whose nonlinearity is a diode: x''' + x'' + x + I (exp(x'/V) − 1) = 0."""
    return y, z, -z - x - current * (jnp.exp(y / voltage) - 1)


@published(
    start=(0.678, 0.1989, -0.6376),
    turn=13.6,
    source="J. C. Sprott, A dynamical system with a strange attractor and invariant tori, Phys. Lett. A 378 (2014) "
    "1361",
)
def strange_attractor_and_tori(x, y, z):
    """A time-reversible flow with a strange attractor beside invariant tori."""
    return y + 2 * x * y + x * z, 1 - 2 * x**2 + y * z, x - x**2 - y**2


@published(
    start=(-1.976, 0.2465, 0.7902),
    turn=5.9,
    conservative=True,
    source="W. G. Hoover, Canonical dynamics: equilibrium phase-space distributions, Phys. Rev. A 31 (1985) 1695, "
    "doi:10.1103/PhysRevA.31.1695; H. A. Posch, W. G. Hoover & F. J. Vesely, Phys. Rev. A 33 (1986) 4253, "
    "doi:10.1103/PhysRevA.33.4253; a as in the dysts collection",
)
def nose_hoover(x, y, z, *, a=1.5):
    """A harmonic oscillator with the Nosé–Hoover thermostat."""
    return y, -x + y * z, a - y**2
