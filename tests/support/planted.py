"""Systems with one mistake each, and what `lh.check` must find: (topic, a pattern in its text)."""

import itertools

import jax
import jax.numpy as jnp

import lyaphybrid as lh

_calls = itertools.count()


def _fall(t, x, args):
    return jnp.stack([x[1], -jnp.ones_like(t)])


def _height(t, x, args):
    return x[0]


def _bounce(t, x, args):
    return jnp.stack([x[0], -0.9 * x[1]])


def _swing(t, x, args):
    return jnp.stack([x[1], -x[0]])


def _impure(t, x, args):
    return jnp.stack([x[1], -x[0] + 1e-3 * next(_calls)])


@jax.custom_jvp
def _cube(x):
    return x**3


@_cube.defjvp
def _wrong_rule(primals, tangents):
    (x,), (dx,) = primals, tangents
    return x**3, 2 * x**2 * dx  # 3 x² dx


def _ball(reset=_bounce, guard=_height, field=_fall, **options) -> lh.Hybrid:
    return lh.Hybrid(field, lh.Transition(guard, reset, **options))


def _two_modes(target) -> lh.Hybrid:
    modes = {"down": _fall, "up": lambda t, x, args: jnp.stack([x[1], jnp.sqrt(x[0] - 1.0)])}
    return lh.Hybrid(modes, lh.Transition(_height, _bounce, source="down", target=target))


def _oregonator(t, x, args):
    """R. J. Field & R. M. Noyes, J. Chem. Phys. 60 (1974) 1877, doi:10.1063/1.1681288."""
    a, b, c = x
    return jnp.stack([77.27 * (b - a * b + a - 8.375e-6 * a**2), (c - b - a * b) / 77.27, 0.161 * (a - c)])


RELAX = lh.Flow(lambda t, x, args: jnp.stack([x[1], 1000.0 * (1 - x[0] ** 2) * x[1] - x[0]]))


def _spiking(t, x, args):
    """An adaptive exponential neuron whose current rises at t = 40."""
    v, w = x
    current = jnp.where(t > 40, 205.0, 175.0)
    rise = -12 * (v + 60) + 24 * jnp.exp((v + 50) / 2) - w + current
    return jnp.stack([rise / 100, (-11 * (v + 60) - w) / 130])


def _by_the_clock(slack):
    """A decay that a clock of period 0.1 stops for a moment: when, from the next multiple of the period."""
    return lh.EventDriven(
        lambda dt, t, x, args: x * jnp.exp(-dt),
        lambda t, x, args: ((jnp.floor(t / 0.1 + slack) + 1) * 0.1 - t, 0),
        lambda t, x, args, which: x + jnp.array([1.0, 0.5]),
        lambda t, x, args, which: jnp.round(t / 0.1) * 0.1 - t + 0 * x[0],
    )


PLANTED = {
    "wrong direction": (_ball(direction=1), [1.0, 0.0], "jumps", "never fired, but it fell"),
    "sign of the reset": (_ball(lambda t, x, args: 0.9 * x), [1.0, 0.0], "jumps", "goes on through"),
    "reset beyond the guard": (_ball(lambda t, x, args: jnp.stack([x[0] - 0.1, -x[1]])), [1.0, 0.0],
                               "jumps", "fires again"),
    "counter": (lh.Flow(_impure), [1.0, 0.0], "functions", "not pure"),
    "field with a sign": (
        lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0] - 0.3 * jnp.sign(x[1] - 0.5)])), [1.0, 0.0],
        "smoothness", "The field jumps",
    ),
    "field with a floor of the time": (
        lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0] + jnp.floor(t)])), [1.0, 0.0],
        "smoothness", "The field jumps",
    ),
    "a step of a current, small beside the spikes": (
        lh.Hybrid(_spiking, lh.Transition(lambda t, x, args: 20.0 - x[0],
                                          lambda t, x, args: jnp.stack([-48.0, x[1] + 30]))),
        [-48.0, 90.0], "smoothness", r"field of mode 'flow' jumps by 0\.3 at t = 40",
    ),
    "a long pulse into a neuron at rest": (
        lh.Hybrid(lambda t, x, args: jnp.where((t > 20) & (t < 300), 2.0, 0.5) - x,
                  lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: 0 * x)),
        [0.0], "smoothness", "field of mode 'flow' jumps by 1.5 at t = 20",
    ),
    "guard with a mod": (
        _ball(guard=lambda t, x, args: jnp.mod(x[0], 1.0) - 0.5, field=lambda t, x, args: jnp.stack([x[1], -x[0]]),
              reset=lambda t, x, args: x * jnp.array([1.0, -0.9])), [2.2, 0.3],
        "smoothness", "guard of transition 0 jumps",
    ),
    "mode that is not there": (_two_modes(lambda t, x, args: 2), [1.0, 0.0], "jumps", "is the mode 2"),
    "field undefined in the target": (_two_modes("up"), [1.0, 0.0], "jumps", "is not finite"),
    "derivative by a wrong rule": (
        lh.Flow(lambda t, x, args: jnp.stack([x[1], -_cube(x[0])])), [1.0, 0.0], "derivatives", "differences give",
    ),
    "reset by a wrong rule": (
        _ball(lambda t, x, args: jnp.stack([x[0], -0.9 * jax.lax.stop_gradient(x[1])])), [1.0, 0.0],
        "derivatives", "reset of transition 0",
    ),
    "root at zero": (
        lh.Flow(lambda t, x, args: jnp.stack([jnp.sqrt(x[0] ** 2), -x[1]])), [0.0, 1.0], "derivatives", "is not finite",
    ),
    "stiff": (RELAX, [2.0, 0.0], "stiffness", "implicit"),
    "stiff later": (lh.Flow(_oregonator), [1.0, 2.0, 3.0], "stiffness", "implicit"),  # from t = 20 on
    "float32": (lh.Flow(_swing), [1.0, 0.0], "precision", "float32"),
    "guard of a clock": (
        lh.Hybrid(_swing, lh.Transition(lambda t, x, args: jnp.sin(t), lambda t, x, args: 0.9 * x)), [1.0, 0.0],
        "clocks", "depends on the time alone",
    ),
    "grazing": (
        lh.Hybrid(_swing, lh.Transition(lambda t, x, args: 1.0 - 1e-9 - x[0], _bounce)), [0.0, 1.0],
        "jumps", "tangentially",
    ),
    "wrong shape": (lh.Flow(lambda t, x, args: x[0]), [1.0, 0.0], "functions", "shape"),
    "wrong number of arguments": (lh.Flow(lambda x, args: -x), [1.0, 0.0], "functions", "argument"),
    "escape": (lh.Flow(lambda t, x, args: x**2), [1.0, 0.5], "run", "Does the state escape"),
    "accumulating bounces": (_ball(lambda t, x, args: jnp.stack([x[0], -0.5 * x[1]])), [1.0, 0.0], "run", "zeno"),
    "start in the wall": (_ball(), [-0.1, 0.0], "jumps", r"beyond the guard of transition 0 \(by 0\.1\)"),
    "weights of the wrong shape": (
        lh.Hybrid(lambda t, v, args: 1.2 - v, lh.Transition(
            lambda t, v, args: 1.0 - v, lambda t, v, args, which: (v * jnp.ones((3, 2))[:, which]).at[which].set(0.0)
        )), [0.0, 0.3, 0.6], "jumps", r"for which = 2 its reset takes entry 2 along axis 1",
    ),
    "no mode continues": (
        lh.Hybrid(_fall, lh.Transition(_height, _bounce, when=lambda t, x, args: x[1] > 0)), [1.0, 0.0],
        "run", "deadlock",
    ),
    "tangent of a mode": (
        lh.Hybrid({"a": _swing}, lh.Transition(lambda t, x, args: x[0] + 0.5, _bounce),
                  tangent={"a": lambda t, x, args, dx: dx * jnp.array([1.0, 0.0])}), [1.0, 0.2],
        "saltation", "differences",
    ),
    "a clock that ticks twice": (_by_the_clock(0.0), [1.0, 2.0], "prediction", "once more, just after"),
    "a clock that misses ticks": (_by_the_clock(1e-9), [1.0, 2.0], "prediction", "steps over it"),
}  # fmt: skip
