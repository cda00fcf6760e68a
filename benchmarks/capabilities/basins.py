"""Basins of attraction, their boundaries and the motions on these, against closed forms and symmetries."""

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, errors_away

TITLE = "Basins of attraction"
KEY = jax.random.key(0)
WELLS = lh.Flow(lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - a * x[1]]))
REPELS, BENDS = 1.3, 2.4  # of the law by which the ball leaves the ground


def newton(n, x, args):
    """Newton's method for z³ = 1, in real numbers: (2 z + 1/z²) / 3."""
    a, b = x
    square = (a * a + b * b) ** 2
    return jnp.stack([(2 * a + (a * a - b * b) / square) / 3, (2 * b - 2 * a * b / square) / 3])


def gap(n, x, args):
    """A tent of slope 3: starts leave through its gap, by the left half to −1, by the right half to 2."""
    inside = jnp.where(x < 1 / 3, 3 * x, jnp.where(x > 2 / 3, 3 - 3 * x, jnp.where(x < 0.5, -1.0, 2.0)))
    return jnp.where(x < 0, -1.0, jnp.where(x > 1, 2.0, inside))


def leaves(t, x, args):
    """A ball that falls with the speed 1 + u leaves the ground with 1 + 1.3 u − 2.4 u³: faster ones go on to rise."""
    u = -x[1] - 1
    return jnp.stack([x[0], 1 + REPELS * u - BENDS * u**3])


BALL = lh.Hybrid(lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]), lh.Transition(lambda t, x, args: x[0], leaves))


def of_balls() -> lh.Basins:
    return lh.basins(BALL, [[0.107, 0.0], [1.2, 0.0]], shape=(110,), t1=60.0)


def two_wells(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.basins(WELLS, [[-2.0, -1.0], [2.0, 1.0]], 0.5, shape=(20, 10), t1=80.0))
    differ = np.mean(found.labels != 1 - found.labels[::-1, ::-1])
    error = max(apart(found.shares, [0.5, 0.5]), float(differ))
    return Row("two wells, shares and each label", "symmetry, exactly 1/2", error, 0.0)


def bouncing_balls(clock: Stopwatch) -> Row:
    found = clock(of_balls)
    heights = [np.max(one.points[:, 0]) for one in found.attractors]
    wrong = np.mean((found.labels == int(np.argmax(heights))) != (found.starts[:, 0] > 0.5))
    truth = "closed form: from above 1/2 a ball goes on to rise"
    return Row("balls that jump high or low, each label", truth, float(wrong), 0.0)


def thirds(clock: Stopwatch) -> Row:
    box = [[-1.0, -1.0], [1.0, 1.0]]
    found = clock(lambda: lh.basins(lh.Map(newton), box, starts=3000, key=KEY, t1=60))
    error = errors_away(found.shares, 1 / 3, found.stderr)
    return Row("Newton's method for z³ = 1, random starts", "symmetry, 1/3 each", error, 3.0, "se")


def along_a_parameter(clock: Stopwatch) -> Row:
    tilted, tilts = lh.Flow(lambda t, x, a: x - x**3 + a["tilt"]), np.array([0.1, 0.2, 0.3])
    how = {"over": {"tilt": tilts}, "t1": 60.0, "starts": 1000, "key": KEY}
    found = clock(lambda: lh.basin_shares(tilted, [[-1.5], [1.5]], {"tilt": 0.0}, **how))
    up = int(found.basins[0].attractors[1].points[0, 0] > 0)
    middle = np.array([np.sort(np.roots([-1.0, 0.0, 1.0, tilt]).real)[1] for tilt in tilts])
    error = errors_away(found.shares[:, up], (1.5 - middle) / 3, found.stderr[:, up])
    return Row("shares along a tilt of two wells", "closed form, the middle root of a cubic", error, 3.0, "se")


def cantor_set(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.basins(lh.Map(gap), [[0.0], [1.0]], shape=(2**13,), t1=60))
    error = abs(found.boundary_dimension().dimension - np.log(2) / np.log(3))
    return Row("dimension of a boundary that is a Cantor set", "closed form, ln 2/ln 3", error, 0.03)


def smooth_boundary(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.basins(WELLS, [[-1.0, -1.0], [1.0, 1.0]], 0.5, shape=(128, 128), t1=80.0))
    return Row("dimension of a smooth boundary", "1", abs(found.boundary_dimension().dimension - 1), 0.05)


def entropy(clock: Stopwatch) -> Row:
    flow = lh.Flow(lambda t, x, a: jnp.stack([x[0] - x[0] ** 3, -x[1]]))
    found = clock(lambda: lh.basins(flow, [[-1.2, -1.5], [1.8, 1.5]], shape=(30, 30), t1=40.0))
    mixed = -(0.4 * np.log(0.4) + 0.6 * np.log(0.6))  # the boundary is behind two of five columns of a box
    of_boxes = found.entropy(5)
    error = max(abs(of_boxes.boundary - mixed), abs(of_boxes.all - mixed / 6))
    return Row("entropy of basins that part at a line", "closed form, 2/5 and 3/5 in one box of six", error, 1e-12)


def edge_of_a_map(clock: Stopwatch) -> Row:
    cubic = lh.Map(lambda n, x, args: args * x - x**3)
    found = lh.basins(cubic, [[-1.3], [1.2]], 1.7, shape=(50,), t1=100)
    edge = clock(lambda: lh.edge_state(cubic, found, 1.7, t1=200, settle=300))
    return Row("edge state of a cubic map, its rate", "closed form, ln 1.7", abs(edge.rate - np.log(1.7)), 1e-6)


def edge_of_balls(clock: Stopwatch) -> Row:
    found = of_balls()
    edge = clock(lambda: lh.edge_state(BALL, found, t1=800.0, settle=400.0))
    energies = edge.x[:, 0] + edge.x[:, 1] ** 2 / 2
    error = max(abs(edge.rate - np.log(REPELS) / 2), apart(energies, 0.5))
    truth = "closed form, the ball that repeats: ln 1.3 in the time 2"
    return Row("edge state of jumping balls, its rate and energy", truth, error, 3e-3)


ROWS = (
    two_wells,
    bouncing_balls,
    thirds,
    along_a_parameter,
    cantor_set,
    smooth_boundary,
    entropy,
    edge_of_a_map,
    edge_of_balls,
)
