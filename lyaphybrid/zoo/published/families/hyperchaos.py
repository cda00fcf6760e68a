"""Flows in four dimensions, most of them with two positive exponents."""

from ..table import published

MEIER = "J. Meier, Presentation of Attractors with Cinema (2003), a collection; as in the dysts collection"


def _lorenz_with_memory(x, y, z, w, a, b, c, d):
    return a * (y - x) + w, x * (b - z) - y, x * y - c * z, d * w - x * z


# No published exponents here: the table of A. Wolf et al., Physica D 16 (1985) 285, could not be read to check them.
@published(
    start=(-24.7, -10.28, 0.1196, 19.28),
    turn=6.0,
    source="O. E. Rössler, An equation for hyperchaos, Phys. Lett. A 71 (1979) 155, doi:10.1016/0375-9601(79)90150-6",
    note="stiff in the spikes of z",
)
def hyper_rossler(x, y, z, w, *, a=0.25, b=3.0, c=0.5, d=0.05):
    """Rössler's equation for hyperchaos."""
    return -y - z, x + a * y + w, b + x * z, -c * z + d * w


@published(start=(13.3, 2.993, 36.85, -0.677), turn=0.7, source=MEIER)
def hyper_lorenz(x, y, z, w, *, a=10.0, b=28.0, c=2.667, d=1.1):
    """Lorenz' equations with a fourth, growing component."""
    return _lorenz_with_memory(x, y, z, w, a, b, c, d)


@published(start=(-3.264, -1.654, 22.06, 8.327), turn=0.7, source=MEIER)
def hyper_jha(x, y, z, w, *, a=10.0, b=28.0, c=2.667, d=1.3):
    """The same with a faster growth."""
    return _lorenz_with_memory(x, y, z, w, a, b, c, d)


@published(
    start=(11.72, 13.48, 28.97, 22.85),
    turn=0.6,
    source="form and parameters as in the dysts collection, which cites a paper on another flow; the hyperchaotic Cai "
    "system is of Wang & Cai (2009), as cited by S. Pakiriswamy & S. Vaidyanathan, Int. J. Adv. Inf. Technol. 2 (2012) "
    "75, doi:10.5121/ijait.2012.2206",
)
def hyper_cai(x, y, z, w, *, a=27.5, b=3.0, c=19.3, d=2.9, e=3.3):
    """A Lorenz-like flow whose third component is driven by y²."""
    return a * (y - x), b * x + c * y - x * z + w, -d * z + y**2, -e * x


@published(
    start=(1.626, 1.852, 19.17, 4.421),
    turn=0.6,
    source="B. Bao & Z. Liu, A hyperchaotic attractor coined from chaotic Lü system, Chin. Phys. Lett. 25 (2008) 2396, "
    "doi:10.1088/0256-307X/25/7/018; form and parameters as in the dysts collection (PredefinedDynamicalSystems.jl has "
    "c = 20.5 and − d y z)",
)
def hyper_bao(x, y, z, w, *, a=36.0, b=3.0, c=20.0, d=0.1, e=21.0):
    """Lü's system with a fourth component."""
    return a * (y - x) + w, c * y - x * z, x * y - b * z, e * x + d * y * z


@published(
    start=(8.113, 10.56, 18.45, -28.38),
    turn=0.7,
    source="A. Chen, J. Lu, J. Lü & S. Yu, Generating hyperchaotic Lü attractor via state feedback control, Physica A "
    "364 (2006) 103, doi:10.1016/j.physa.2005.09.039",
    note="Motions leave for infinity in the end, after some 4000 units of time: d = 1.3 ends the published range.",
)
def hyper_lu(x, y, z, w, *, a=36.0, b=3.0, c=20.0, d=1.3):
    """Lü's system under state feedback."""
    return a * (y - x) + w, -x * z + c * y, x * y - b * z, d * w + x * z


@published(
    start=(6.174, 6.282, 19.46, 4.474),
    turn=0.8,
    source="S. Pang & Y. Liu, A new hyperchaotic system from the Lü system and its control, J. Comput. Appl. Math. 235 "
    "(2011) 2775, doi:10.1016/j.cam.2010.11.029",
)
def hyper_pang(x, y, z, w, *, a=36.0, b=3.0, c=20.0, d=2.0):
    """Lü's system with another feedback."""
    return a * (y - x), -x * z + c * y + w, x * y - b * z, -d * (x + y)


@published(
    start=(87.27, 69.03, 37.13, 181.5),
    turn=0.1,
    source="G. Qi, M. A. van Wyk, B. J. van Wyk & G. Chen, On a new hyperchaotic system, Phys. Lett. A 372 (2008) 124, "
    "doi:10.1016/j.physleta.2007.10.082",
)
def hyper_qi(x, y, z, w, *, a=50.0, b=24.0, c=13.0, d=8.0, e=33.0, f=30.0):
    """A flow with two large positive exponents."""
    return a * (y - x) + y * z, b * (x + y) - x * z, -c * z - e * w + x * y, -d * w + f * z + x * y


@published(
    start=(2.387, 0.7779, 42.95, 8.527),
    turn=0.6,
    source="form and parameters as in the dysts collection, which cites a paper on a flow in three dimensions: Z. "
    "Wang, Y. Sun, B. J. van Wyk, G. Qi & M. A. van Wyk, Braz. J. Phys. 39 (2009) 547",
)
def hyper_wang(x, y, z, w, *, a=10.0, b=40.0, c=2.5, d=10.6, e=4.0):
    """Liu's system with a fourth component."""
    return a * (y - x), x * (b - z) + w, -c * z + e * x**2, -d * x


@published(
    start=(4.594, -0.0114, -3.511, 12.41),
    turn=1.0,
    source="form and parameters as in the dysts collection, which cites C. Letellier & O. E. Rössler, Hyperchaos, "
    "Scholarpedia 2 (2007) 1936, doi:10.4249/scholarpedia.1936; the hyperchaotic Xu system is of Xu, Cai & Zheng "
    "(2009), as cited by S. Vaidyanathan, Int. J. Comput. Sci. Eng. Inf. Technol. 2 (2012) 81, "
    "doi:10.5121/ijcseit.2012.2306",
)
def hyper_xu(x, y, z, w, *, a=10.0, b=40.0, c=2.5, d=2.0, e=16.0):
    """A Lorenz-like flow whose fourth component is driven by x z."""
    return a * (y - x) + w, b * x + e * x * z, -c * z - x * y, x * z - d * y


@published(start=(3.14, 2.296, 18.15, -0.3016), turn=0.6, source=MEIER)
def hyper_yan(x, y, z, w, *, a=37.0, b=3.0, c=26.0, d=38.0):
    """Chen's system with a fourth component that follows z (y − x)."""
    return a * (y - x), x * (c - a - z) + c * y, -b * z + x * y - z * (y - x) - w, -d * w + z * (y - x)


@published(
    start=(-9.161, -4.157, 46.55, -0.4595),
    turn=0.7,
    source=MEIER,
)
def hyper_yang_chen(x, y, z, w, *, a=30.0, b=3.0, c=35.0, d=8.0):
    """A Lorenz-like flow without damping of the second component, with a slow fourth one."""
    return a * (y - x), x * (c - z) + w, -b * z + x * y, -d * x


@published(
    start=(0.1898, 0.9969, 7.932, 3.224),
    turn=0.4,
    source="G. Qi, S. Du, G. Chen, Z. Chen & Z. Yuan, On a four-dimensional chaotic system, Chaos Solitons Fractals 23 "
    "(2005) 1671; form and parameters as in the dysts collection, which cites another paper of G. Qi",
)
def qi(x, y, z, w, *, a=45.0, b=10.0, c=1.0, d=10.0):
    """A flow with a product of three components in each equation."""
    return a * (y - x) + y * z * w, b * (x + y) - x * z * w, -c * z + x * y * w, -d * w + x * y * z
