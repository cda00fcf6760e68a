"""Systems that break the rules, or are hard: each must answer soon, by an error, a status or a note.

`HOSTILE` maps names to (a call, what it is to say): a pattern in the text of the error, or in that of the result.
"""

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh

LONG = 1e4  # so long that a stalled run would take hours


def _spectrum(system, x0, args=None, *, t1=LONG, **options):
    return lambda: lh.lyapunov_spectrum(system, x0, args, t1=t1, **options)


def _stack(*components):
    return jnp.stack([jnp.asarray(c) for c in components])


# --- fields that jump ------------------------------------------------------------------------------------------------

FRICTION = lh.Flow(lambda t, x, args: _stack(x[1], -x[0] - 0.5 * jnp.sign(x[1] - 0.1)))
WHERE = lh.Flow(lambda t, x, args: _stack(jnp.where(x[0] > 0, -1.0, 1.0), -x[1]))
RELAY = lh.Flow(lambda t, x, args: _stack(x[1], x[2], -2 * x[1] - 3 * x[2] - jnp.sign(x[0] + x[1] + x[2])))
STAIRS = lh.Flow(lambda t, x, args: _stack(-jnp.floor(1e3 * x[0]), 1.0 + 0 * x[1]))

# --- guards that are none --------------------------------------------------------------------------------------------

MOD = lh.Hybrid(
    lambda t, x, args: jnp.ones_like(x),
    lh.Transition(lambda t, x, args: jnp.mod(x[0], 1.0) - 0.5, lambda t, x, args: x, direction=0),
)
FLOOR = lh.Hybrid(
    lambda t, x, args: _stack(x[1], -x[0]),
    lh.Transition(lambda t, x, args: jnp.floor(3 * x[0]) + 0.5, lambda t, x, args: -x, direction=0),
)
NEVER = lh.Hybrid(
    lambda t, x, args: _stack(x[1], -x[0]), lh.Transition(lambda t, x, args: 5 + x[0], lambda t, x, args: -x)
)
ALWAYS = lh.Hybrid(lambda t, x, args: -x, lh.Transition(lambda t, x, args: 0 * x[0], lambda t, x, args: x / 2))
SAME = lh.Hybrid(lambda t, x, args: -x, lh.Transition(lambda t, x, args: x[0] - 0.5, lambda t, x, args: x))
TOUCHING = lh.Hybrid(
    lambda t, x, args: _stack(x[1], -x[0]), lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: -x)
)
ONTO = lh.Hybrid(
    lambda t, x, args: -jnp.ones_like(x), lh.Transition(lambda t, x, args: x[0], lambda t, x, args: 0 * x, direction=0)
)

# --- motions that are hard -------------------------------------------------------------------------------------------

STIFF = lh.Flow(lambda t, x, args: _stack(-1e9 * (x[0] - jnp.cos(t)), -x[1]))
ESCAPING = lh.Flow(lambda t, x, args: x**2)
NAN = lh.Flow(lambda t, x, args: jnp.where(t < 3.0, -x, jnp.nan))
HUGE = lh.Flow(lambda t, x, args: 1e150 * _stack(x[1] / 1e150, -x[0] / 1e150) * 1e10)
TINY = lh.Flow(lambda t, x, args: _stack(x[1], -x[0]) * 1e-200)
BOUNCING = lh.Hybrid(
    lambda t, x, args: _stack(x[1], -1.0 + 0 * x[0]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: _stack(x[0], -0.9 * x[1])),
)
CHATTERING = lh.Hybrid(
    lambda t, x, args: _stack(x[1], -1.0 - 3 * x[1]),
    [lh.Transition(lambda t, x, args: x[0], lambda t, x, args: _stack(0 * x[0], 1e-6 + 0 * x[1]))],
)
EDGE = lh.Flow(lambda t, x, args: -jnp.sign(x) * jnp.sqrt(jnp.abs(x)))
CIRCLE = lh.Flow(lambda t, x, args: _stack(x[1], -x[0]))


def _impure():
    """A field that throws dice, behind JAX's back."""
    random = np.random.default_rng(0)

    @jax.custom_jvp
    def kick(x):
        return jax.pure_callback(lambda x: random.standard_normal(x.shape), jax.ShapeDtypeStruct(x.shape, x.dtype), x)

    kick.defjvp(lambda at, along: (kick(*at), 0 * along[0]))

    def noisy(t, x, args):
        return -x + kick(x)

    return lh.trajectory(lh.Flow(noisy), [1.0], t1=LONG, n=10)


HOSTILE = {
    "friction by sign": (_spectrum(FRICTION, [1.0, 0.0]), "stalled|step_underflow"),
    "field by where": (_spectrum(WHERE, [1.0, 1.0]), "stalled|step_underflow"),
    "relay by sign": (_spectrum(RELAY, [1.0, 0.2, 0.1]), "stalled|step_underflow"),
    "field by floor": (_spectrum(STAIRS, [0.5, 0.0]), "status ok"),
    "guard by mod": (_spectrum(MOD, [0.1, 0.2]), "stalled|step_underflow"),
    "guard by floor": (_spectrum(FLOOR, [1.0, 0.0]), "stalled|step_underflow"),
    "guard never zero": (_spectrum(NEVER, [1.0, 0.0], t1=100.0), "guard_unreached"),
    "guard always zero": (_spectrum(ALWAYS, [1.0], t1=10.0), "guard_unreached"),
    "reset that changes nothing": (_spectrum(SAME, [1.0], t1=10.0), "identity_reset"),
    "guard that is touched": (_spectrum(TOUCHING, [1.0, 0.0], t1=100.0), "grazing|jumps"),
    "reset onto the guard": (_spectrum(ONTO, [1.0]), "status ok|deadlock|zeno"),
    "stiff": (_spectrum(STIFF, [1.0, 1.0]), "stalled|step_underflow"),
    "escaping": (_spectrum(ESCAPING, [1.0]), "nonfinite|step_underflow"),
    "nan after some time": (_spectrum(NAN, [1.0]), "nonfinite|stalled"),
    "huge rate": (_spectrum(HUGE, [1.0, 0.0]), "stalled"),
    "tiny rate": (_spectrum(TINY, [1.0, 0.0]), "status ok"),
    "bouncing to rest": (_spectrum(BOUNCING, [1.0, 0.0]), "zeno"),
    "chattering": (_spectrum(CHATTERING, [1.0, 0.0]), "stalled|zeno"),
    "square root": (_spectrum(EDGE, [1.0]), "stalled|step_underflow|nonfinite|rank_lost"),
    "far end": (_spectrum(CIRCLE, [1.0, 0.0], t1=1e30), "stalled"),
    "section never crossed": (
        lambda: lh.poincare_section(CIRCLE, [1.0, 0.0], section=lambda t, x, args: x[0] - 5, n=10),
        "stalled|no_more_jumps",
    ),
    "jumps that do not come": (_spectrum(NEVER, [1.0, 0.0], t1=10, clock="jumps"), "stalled|no_more_jumps"),
    "dice": (_impure, "stalled|step_underflow"),
    "wrong shape": (_spectrum(lh.Flow(lambda t, x, args: x[:1]), [1.0, 0.0]), "must return an array of x's shape"),
    "infinite start": (_spectrum(CIRCLE, [np.inf, 0.0]), "must be finite"),
}


def answer(name: str) -> str:
    """What a user reads."""
    try:
        return str(HOSTILE[name][0]())
    except (ValueError, lh.RunFailedError) as error:
        return f"{error}\n{getattr(error, 'result', '')}"
