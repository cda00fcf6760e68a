"""Populations, tumours and cells."""

import math

import jax.numpy as jnp
import numpy as np

from ....integrators import RungeKutta
from ..table import published

SUPPLY = np.array([6.0, 10.0, 14.0, 4.0, 9.0])  # concentrations of the five resources that flow in
CONTENT = np.array(  # of each resource (row) in each species
    [
        [0.04, 0.04, 0.07, 0.04, 0.04],
        [0.08, 0.08, 0.08, 0.10, 0.08],
        [0.10, 0.10, 0.10, 0.10, 0.14],
        [0.05, 0.03, 0.03, 0.03, 0.03],
        [0.07, 0.09, 0.07, 0.07, 0.07],
    ]
)
HALF_SATURATION = np.array(
    [
        [0.39, 0.34, 0.30, 0.24, 0.23],
        [0.22, 0.39, 0.34, 0.30, 0.27],
        [0.27, 0.22, 0.39, 0.34, 0.30],
        [0.30, 0.24, 0.22, 0.39, 0.34],
        [0.34, 0.30, 0.22, 0.20, 0.39],
    ]
)
CALCIUM = "G. Houart, G. Dupont & A. Goldbeter, Bursting, chaos and birhythmicity originating from self-modulation of "
CALCIUM += "the inositol 1,4,5-trisphosphate signal in a model for intracellular Ca²⁺ oscillations, Bull. Math. Biol. "
CALCIUM += "61 (1999) 507, doi:10.1006/bulm.1999.0095"


@published(
    start=(0.8524, 0.09697, 10.24),
    turn=70.0,
    source="A. Hastings & T. Powell, Chaos in a three-species food chain, Ecology 72 (1991) 896, doi:10.2307/1940591",
)
def hastings_powell(x, y, z, *, a1=5.0, a2=0.1, b1=3.0, b2=2.0, d1=0.4, d2=0.01):
    """A food chain of three species."""
    eaten1, eaten2 = a1 * x * y / (1 + b1 * x), a2 * y * z / (1 + b2 * y)
    return x * (1 - x) - eaten1, eaten1 - eaten2 - d1 * y, eaten2 - d2 * z


@published(
    start=(4.582, 6.66, 0.02357),
    turn=6.6,
    source="B. Blasius, A. Huppert & L. Stone, Complex dynamics and phase synchronization in spatially extended "
    "ecological systems, Nature 399 (1999) 354, doi:10.1038/20676",
)
def blasius(x, y, z, *, a=1.0, b=1.0, c=10.0, alpha1=0.2, alpha2=1.0, k1=0.05, z_rest=0.006):
    """Vegetation, herbivores and predators: cycles of one length with chaotic heights."""
    grazed, hunted = alpha1 * x * y / (1 + k1 * x), alpha2 * y * z
    return a * x - grazed, -b * y + grazed - hunted, -c * (z - z_rest) + hunted


@published(
    start=(136.8, 87.23, 43.26),
    turn=1.0,
    source="R. K. Upadhyay, N. Bairagi, K. Kundu & J. Chattopadhyay, Chaos in eco-epidemiological problem of the "
    "Salton Sea and its possible control, Appl. Math. Comput. 196 (2008) 392, doi:10.1016/j.amc.2007.06.007",
)
def salton_sea(x, y, z, *, r=22.0, k=400.0, infection=0.06, m=15.5, a=15.0, mu=3.4, theta=10.0, d=8.3):
    """Sound fish, infected fish and pelicans."""
    caught = y * z / (y + a)
    return (
        r * x * (1 - (x + y) / k) - infection * x * y,
        infection * x * y - m * caught - mu * y,
        theta * caught - d * z,
    )


@published(
    start=(0.018, 0.0137),
    turn=1.0,
    source="P. Turchin & I. Hanski, An empirically based model for latitudinal gradient in vole population dynamics, "
    "Am. Nat. 149 (1997) 842, doi:10.1086/286027",
)
def turchin_hanski(t, n, p, *, a=8.0, d=0.04, e=0.5, g=0.1, h=0.8, years=1.0, r=8.12, s=1.25):
    """Voles and weasels under the seasons; time in years."""
    season = 1 - e * jnp.sin(2 * math.pi * years * t)
    dn = r * season * n - r * n**2 - g * n**2 / (n**2 + h**2) - a * n * p / (n + d)
    return dn, s * season * p - s * p**2 / n


@published(
    start=(0.486, 0.4136, 0.4172),
    turn=60.0,
    source="W. Gilpin & M. W. Feldman, A phase transition induces chaos in a predator–prey ecosystem with a dynamic "
    "fitness landscape, PLoS Comput. Biol. 13 (2017) e1005644, doi:10.1371/journal.pcbi.1005644; form as in the dysts "
    "collection",
)
def coevolving_predator_prey(
    x,
    y,
    q,
    *,
    a1=2.5,
    a2=0.05,
    a3=0.4,
    b1=6.0,
    b2=1.333,
    d1=0.16,
    d2=0.004,
    delta=1.0,
    k1=6.0,
    k2=9.0,
    k4=9.0,
    v=0.33333,
):
    """Prey, predators and a trait q of the prey that evolves."""
    growth = a1 * q * (1 - k1 * x * (delta - 1) * q) / (1 + b1 * q)
    death = d1 * (1 - k2 * (delta**2 - 1) * q**2 + k4 * (delta**4 - 1) * q**4)
    slope = -a1 * k1 * x * q * delta / (1 + b1 * q) - d1 * (-2 * k2 * q * delta**2 + 4 * k4 * q**3 * delta**4)
    return x * (growth - death - a3 * y / (1 + b2 * x)), y * (a2 * x / (1 + b2 * x) - d2), v * slope


@published(
    start=(9.432, 18.84, 34.38, 15.09, 42.23, 0.1703, 0.1014, 0.3148, 0.2125, 0.226),
    turn=43.0,
    source="R. MacArthur, Species packing, and what competition minimizes, Proc. Natl. Acad. Sci. 64 (1969) 1369, "
    "doi:10.1073/pnas.64.4.1369; J. Huisman & F. J. Weissing, Biodiversity of plankton by species oscillations and "
    "chaos, Nature 402 (1999) 407, doi:10.1038/46540",
    note="min over resources: the field is continuous, its derivative is not",
    method=lambda: RungeKutta("dopri5", rtol=1e-7, atol=1e-10),
)
def macarthur(*x, supply=0.25, mortality=0.25, rate=1.0):
    """Five species of phytoplankton that compete for five resources."""
    species, resources = jnp.stack(x[:5]), jnp.stack(x[5:])
    growth = jnp.min(rate * resources[:, None] / (HALF_SATURATION + resources[:, None]), axis=0)
    used = CONTENT @ (growth * species)
    return jnp.concatenate([species * (growth - mortality), supply * (SUPPLY - resources) - used])


@published(
    start=(0.3275, 0.4646, 0.0003618),
    turn=30.0,
    source="M. Itik & S. P. Banks, Chaos in a three-dimensional cancer model, Int. J. Bifurcation Chaos 20 (2010) 71, "
    "doi:10.1142/S0218127410025417",
)
def itik_banks(x, y, z, *, a12=1.0, a13=2.5, a21=1.5, a31=0.2, d3=0.5, k3=1.0, r2=0.6, r3=4.5):
    """Tumour cells, healthy cells and effector cells."""
    return (
        x * (1 - x - a12 * y - a13 * z),
        r2 * y * (1 - y) - a21 * x * y,
        z * (r3 * x / (x + k3) - a31 * x - d3),
    )


@published(
    start=(0.6203, 0.924, 0.9885, 0.817, 0.9611, 0.9894),
    turn=50.0,
    source="P.-C. Romond, M. Rustici, D. Gonze & A. Goldbeter, Alternating oscillations and chaos in a model of two "
    "coupled biochemical oscillators driving successive phases of the cell cycle, Ann. N. Y. Acad. Sci. 879 (1999) "
    "180, doi:10.1111/j.1749-6632.1999.tb10419.x",
)
def cell_cycle(
    c1, m1, x1, c2, m2, x2, *, k=0.01, kc=0.5, kd=0.02, kim=0.65, v2=0.15, v4=0.05, vm1=0.3, vm3=0.1, decay=0.001,
    vd=0.025, vi=0.05,
):  # fmt: skip
    """Two biochemical oscillators that inhibit each other and drive two phases of the cell cycle."""

    def one(c, m, x, other):
        dc = vi * kim / (kim + other) - vd * x * c / (kd + c) - decay * c
        dm = vm1 * c / (kc + c) * (1 - m) / (k + 1 - m) - v2 * m / (k + m)
        return dc, dm, m * vm3 * (1 - x) / (k + 1 - x) - v4 * x / (k + x)

    return *one(c1, m1, x1, m2), *one(c2, m2, x2, m1)


@published(
    start=(1.54, 5.371, 41.05, 11.62),
    turn=24.0,
    source="J.-C. Leloup, D. Gonze & A. Goldbeter, Limit cycle models for circadian rhythms based on transcriptional "
    "regulation in Drosophila and Neurospora, J. Biol. Rhythms 14 (1999) 433, doi:10.1177/074873099129000948; form "
    "and parameters as in the dysts collection",
)
def circadian_rhythm(
    t, m, fc, fs, fn, *, ki=1.0, k=0.5, k1=0.3, k2=0.15, kd=1.4, kdn=0.4, km=0.4, ks=1.0, period=24.0, vc=2.5, vd=6.0,
    vdn=1.5, vm=0.7, vmax=4.7, vmin=1.0,
):  # fmt: skip
    """The FRQ protein of Neurospora under a cycle of light and darkness; time in hours."""
    light = vc * ((1 + jnp.cos(2 * math.pi * t / period)) / 2 + vmin) * (vmax - vmin)
    dm = light * ki**4 / (ki**4 + fn**4) - vm * m / (km + m)
    into = k1 * fc - k2 * fn
    return dm, ks * m - into - k * fc, k * fc - vd * fs / (kd + fs), into - vdn * fn / (kdn + fn)


def _calcium(z, y, a, stimulus, v4, vm3, vm5, k2, k5, ka, kd, ky, kz, eps, p):
    pumped = 6 * z**2 / (k2**2 + z**2)
    released = vm3 * z**2 / (kz**2 + z**2) * y**2 / (ky**2 + y**2) * a**4 / (ka**4 + a**4)
    broken_down = vm5 * a**p / (k5**p + a**p) * z**4 / (kd**4 + z**4)
    exchanged = released - pumped + y
    return 2 + 2 * stimulus + exchanged - 10 * z, -exchanged, stimulus * v4 - broken_down - eps * a


@published(start=(0.4632, 0.8086, 0.1171), turn=1.3, source=CALCIUM)
def calcium(
    z, y, a, *, stimulus=0.65, v4=3.0, vm3=30.0, vm5=50.0, k2=0.1, k5=0.3194, ka=0.1, kd=1.0, ky=0.3, kz=0.6, eps=13.0
):
    """Calcium in the cytosol and in its store, and the messenger that releases it."""
    return _calcium(z, y, a, stimulus, v4, vm3, vm5, k2, k5, ka, kd, ky, kz, eps, 1)


@published(start=(0.5258, 0.7958, 0.3097), turn=0.66, source=CALCIUM)
def calcium_quasiperiodic(
    z, y, a, *, stimulus=0.51, v4=5.0, vm3=20.0, vm5=30.0, k2=0.1, k5=0.3, ka=0.2, kd=0.5, ky=0.2, kz=0.5, eps=0.1
):
    """The same with parameters of quasi-periodic oscillations."""
    return _calcium(z, y, a, stimulus, v4, vm3, vm5, k2, k5, ka, kd, ky, kz, eps, 2)


@published(
    start=(33.31, 88.64, 0.1098),
    turn=50.0,
    source="O. Decroly & A. Goldbeter, Birhythmicity, chaos, and other patterns of temporal self-organization in a "
    "multiply regulated biochemical system, Proc. Natl. Acad. Sci. 79 (1982) 6917, doi:10.1073/pnas.79.22.6917; "
    "parameters as in the dysts collection",
)
def glycolytic_oscillation(
    a, b, c, *, d=0.0, k=4.422, l1=5e8, l2=100.0, nu=1.0, q1=50.0, q2=0.02, s1=22.2222, s2=22.2222
):
    """Two enzymes in a row, each activated by its own product."""
    first = s1 * a * (1 + a) * (1 + b) ** 2 / (l1 + (1 + a) ** 2 * (1 + b) ** 2)
    second = s2 * b * (1 + d * b) * (1 + c) ** 2 / (l2 + (1 + d * b) ** 2 * (1 + c) ** 2)
    return nu - first, q1 * first - second, q2 * second - k * c
