"""Phase responses and isostables of cycles with jumps, against closed forms and kicks of whole motions."""

import itertools

import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, off

TITLE = "Phase responses and isostables through jumps"
PHASES, KICKED = 40, 2  # phases of a cycle, and of those how many are kicked
KICKS = "finite kicks of whole motions, differences of sixth order"
SIXTH_ORDER = np.array([45.0, -9.0, 1.0]) / 60


def clock_field(t, x, a):
    return x * (1 - x @ x) + jnp.stack([-x[1], x[0]])


def sheared(t, x, a):
    """r' = a r (1 − r²), φ' = 2 r²: the phase is (φ + 2/a ln r) / 2."""
    square = x @ x
    return jnp.stack([a * (1 - square) * x[0] - 2 * square * x[1], 2 * square * x[0] + a * (1 - square) * x[1]])


LEAKY = lh.Hybrid(lambda t, v, args: args - v, lh.Transition(lambda t, v, args: 1.0 - v[0], lambda t, v, args: 0 * v))
WALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], 0.8 * (1 - x[0] ** 2) * x[1] - x[0]]),
    lh.Transition(lambda t, x, args: x[0] + 1.2, lambda t, x, args: jnp.stack([x[0], -0.7 * x[1]])),
)


def relay_with_hysteresis() -> lh.Hybrid:
    """x'' + 1.5 x' + x = ∓1, switched where x crosses ±0.3."""

    def side(u):
        return lambda t, x, args: jnp.stack([x[1], -x[0] - 1.5 * x[1] - u])

    up = lh.Transition(lambda t, x, args: x[0] - 0.3, source="low", target="high", direction=1)
    down = lh.Transition(lambda t, x, args: x[0] + 0.3, source="high", target="low", direction=-1)
    return lh.Hybrid({"high": side(1.0), "low": side(-1.0)}, [up, down])


def ring_of_genes() -> lh.Hybrid:
    """Three genes, each on or off, which repress each other in a ring: x' = −x ± 1."""
    names = ["".join(signs) for signs in itertools.product("+-", repeat=3)]

    def field(name):
        signs = np.roll([1.0 if one == "+" else -1.0 for one in name], 1)
        return lambda t, x, args: -x - signs

    def switch(name, i):
        other = name[:i] + ("-" if name[i] == "+" else "+") + name[i + 1 :]
        direction = -1 if name[i] == "+" else 1
        return lh.Transition(lambda t, x, args: x[i], source=name, target=other, direction=direction)

    return lh.Hybrid({name: field(name) for name in names}, [switch(n, i) for n in names for i in range(3)])


def kicks_apart(found: lh.PhaseResponse, kicks: float, bound: tuple[int, ...] = ()) -> float:
    """The largest difference of Z from that of finite kicks, relative to the largest of each component.

    Args:
        found: of a cycle.
        kicks: their size, relative to the extent of the cycle.
        bound: modes that are bound to a surface, which a kick would leave.
    """
    n, d = found.x.shape
    modes, extent = found.mode, np.ptp(found.x, axis=0)
    steps = np.max(np.abs(np.roll(found.x, -1, axis=0) - np.roll(found.x, 1, axis=0)), axis=1)
    quiet = (modes == np.roll(modes, 1)) & (modes == np.roll(modes, -1)) & (steps < 0.5 * np.max(extent))
    far = np.flatnonzero(quiet & ~np.isin(modes, bound))  # from there no kick crosses a guard
    worst = 0.0
    for k in far[:: max(1, len(far) // KICKED)][:KICKED]:
        for i, size in enumerate(kicks * extent):
            unit = size * np.eye(d)[i]
            each = [found.finite(m * unit, at=[k])[0] - found.finite(-m * unit, at=[k])[0] for m in (1, 2, 3)]
            scale = np.max(np.abs(found.response[:, i]))
            worst = max(worst, abs(SIXTH_ORDER @ each / size - found.response[k, i]) / scale)
    return worst


def kicked(clock: Stopwatch, name: str, system, x0, args=None, *, kicks=1e-3, bound=(), **how) -> Row:
    found = clock(lambda: lh.phase_response(system, x0, args, phases=PHASES, **how))
    return Row(name, KICKS, kicks_apart(found, kicks, bound), 1e-8, "relative")


def smooth_clock(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.phase_response(lh.Flow(clock_field), [1.0, 0.2], phases=16))
    x, y = found.x.T
    radial = found.isostables[:, :, 0] / found.isostables[0, 0, 0] * x[0]  # along the radius, which is 1
    error = max(apart(found.response, np.stack([-y, x], axis=1)), apart(radial, found.x))
    return Row("a smooth clock, its isostables too", "closed form", error, 1e-8)


def shear(clock: Stopwatch) -> Row:
    kick, a = np.array([0.05, 0.0]), 0.3
    found, ahead = clock(lambda: ahead_of(lh.phase_response(lh.Flow(sheared), [1.0001, 0.0], a, phases=4), kick))
    phase = lambda x: (np.arctan2(x[:, 1], x[:, 0]) + 2 / a * np.log(np.hypot(*x.T))) / 2  # noqa: E731
    error = ahead - (phase(found.x + kick) - phase(found.x))
    error -= np.pi * np.round(error / np.pi)
    return Row("finite kicks under shear", "closed form, isochrones that are spirals", apart(error, 0.0), 1e-9)


def ahead_of(found: lh.PhaseResponse, kick) -> tuple[lh.PhaseResponse, np.ndarray]:
    return found, found.finite(kick)


def leaky_neuron(clock: Stopwatch) -> Row:
    found = clock(lambda: lh.phase_response(LEAKY, [0.5], 1.7, phases=PHASES))
    error = max(off(found.response, 1 / (1.7 - found.x)), off(found.period, np.log(1.7 / 0.7)))
    return Row("a leaky neuron", "closed form, 1/(I − v)", error, 1e-10, "relative")


def impact_oscillator(clock: Stopwatch) -> Row:
    return kicked(clock, "van der Pol's oscillator at a wall", WALL, [1.0, 0.5], transient=60.0)


def relay(clock: Stopwatch) -> Row:
    return kicked(clock, "a relay with hysteresis", relay_with_hysteresis(), [0.0, 0.5], mode="low", transient=60.0)


def genes(clock: Stopwatch) -> Row:
    start = [0.6, -0.3, 0.2]
    return kicked(clock, "a Glass network of three genes", ring_of_genes(), start, mode="+-+", transient=60.0)


def stick_slip(clock: Stopwatch) -> Row:
    belt = lh.zoo.stick_slip_belt()
    bound = tuple(i for i, project in enumerate(belt.system.tangent) if project is not None)
    how = {"mode": belt.mode, "transient": 60.0, "bound": bound}
    return kicked(clock, "a block on a belt, stick and slip", belt.system, belt.x0, belt.args, **how)


def walker(clock: Stopwatch) -> Row:
    one = lh.zoo.simplest_walker()
    how = {"mode": one.mode, "transient": 40.0, "kicks": 1.1e-4}
    return kicked(clock, "the simplest walker", one.system, one.x0, one.args, **how)


ROWS = (smooth_clock, shear, leaky_neuron, impact_oscillator, relay, genes, stick_slip, walker)
