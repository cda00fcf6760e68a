"""What several test files share: systems, so that their functions are compiled once; a look into jaxprs."""

import jax.numpy as jnp

import lyaphybrid as lh
from lyaphybrid import STATUS

# --- a ball between a floor and a ceiling: its parameters lead to every status of a flow with events ---------------

BALL_METHOD = lh.RungeKutta("dopri5")
BALL_BLOCKS = 8


def _fly(t, x, args):
    dry = args["dry"] * jnp.sign(x[1])  # a field that jumps, which no method can integrate
    return jnp.stack([x[1], args["escape"] * x[0] ** 3 - args["gravity"] - dry])


BALL = lh.Hybrid(
    _fly,
    [
        lh.Transition(
            lambda t, x, args: x[0],
            lambda t, x, args: jnp.stack([x[0], -args["restitution"] * x[1]]),
            when=lambda t, x, args: args["floor"] > 0,
        ),
        lh.Transition(lambda t, x, args: args["ceiling"] - x[0], terminal=True),
    ],
)


def ball_args(**changes) -> dict:
    """An elastic ball with gravity 1 under a ceiling out of reach, but for the changes."""
    usual = {"gravity": 1.0, "restitution": 1.0, "floor": 1.0, "ceiling": 100.0, "escape": 0.0, "dry": 0.0}
    return usual | changes


def ball_spectrum(x0=(0.5, 0.0), *, t1=20.0, args=None, **changes):
    """The spectrum of the ball; options of `lyapunov_spectrum` and parameters of the ball by name."""
    options = {"blocks": BALL_BLOCKS, "method": BALL_METHOD, "throw": False, "max_steps": None, "t0": 0.0}
    options |= {name: changes.pop(name) for name in tuple(changes) if name in options}
    return lh.lyapunov_spectrum(BALL, x0, ball_args(**changes) if args is None else args, t1=t1, **options)


# Lanes of one compiled function: without an event, with different numbers of them, and failing in every way.
BALL_LANES = [
    ({"gravity": 0.0}, STATUS.ok, 0),
    ({}, STATUS.ok, 10),
    ({"gravity": 2.5}, STATUS.ok, 16),
    ({"restitution": 0.95}, STATUS.ok, 14),
    ({"restitution": 0.8}, STATUS.zeno, None),
    ({"floor": 0.0}, STATUS.deadlock, 0),
    ({"gravity": -1.0, "ceiling": 0.6}, STATUS.terminated, 1),
    ({"gravity": 0.0, "escape": 1.0, "ceiling": 1e300}, STATUS.nonfinite, 0),
    ({"dry": 1e9}, STATUS.step_underflow, 0),
]
BALL_START = (0.5, 0.1)


def ball_lane(args):
    """A spectrum as its parameters decide; it starts at t = 1, where a step can be too short."""
    return ball_spectrum(BALL_START, args=args, t0=1.0)


# --- a ball on a table that moves, kicked by a clock: guard, reset and clock depend on time and parameters ---------

TABLE_METHOD = lh.RungeKutta("rk4", dt=0.05)
TABLE_ARGS = {"gravity": 1.0, "restitution": 0.8, "amplitude": 0.2, "omega": 1.3, "period": 0.9, "kick": 0.1}


def _above(t, x, args):
    return x[0] - args["amplitude"] * jnp.sin(args["omega"] * t)


def _bounce(t, x, args):
    table = args["amplitude"] * args["omega"] * jnp.cos(args["omega"] * t)
    return jnp.stack([x[0], table - args["restitution"] * (x[1] - table)])


def _kick(t, x, args):
    return jnp.stack([x[0], x[1] + args["kick"] * jnp.cos(x[0]) * jnp.sin(t)])


TABLE = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -args["gravity"] - 0.05 * x[1] + 0.1 * jnp.cos(t)]),
    [lh.Transition(_above, _bounce), lh.Transition(every=lambda args: args["period"], phase=0.3, reset=_kick)],
)

# --- smooth systems ------------------------------------------------------------------------------------------------

LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))
HENON = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))


# --- what a traced function is made of ------------------------------------------------------------------------------


def primitives(equations) -> set[str]:
    """The names of all operations in equations of a jaxpr, those inside calls, loops and branches included."""
    names = {eqn.primitive.name for eqn in equations}
    for eqn in equations:
        for value in eqn.params.values():
            for one in value if isinstance(value, tuple) else (value,):
                names |= primitives(getattr(one, "eqns", ()))
    return names


def onto(x0, x1):
    """A reset to (x0, x1)."""
    return lambda t, x, args: jnp.stack([0 * x[0] + x0, 0 * x[1] + x1])


# Each of two guards throws the state beyond the other one, for ever.
ENDLESS_CASCADE = lh.Hybrid(
    lambda t, x, args: -jnp.ones_like(x),
    [lh.Transition(lambda t, x, args: x[0], onto(1.0, -1.0)), lh.Transition(lambda t, x, args: x[1], onto(-1.0, 1.0))],
    max_cascade=3,
)


# --- bodies that do not see each other, each with the time of its own next event -------------------------------------


def alone(ahead):
    """The schedule of rows y; `ahead(t, y)` gives their times, of comoving rows at t since the last rebasing."""
    return lh.Schedule(
        init=lambda t, y, args: ahead(t, y),
        next=lambda times: (jnp.min(times), jnp.argmin(times)),
        update=lambda times, t, y, args, which: times.at[which].set(ahead(t, y)[which]),
        shift=lambda times, dt: times - dt,
        touch=lambda which: which[None],
    )


def wall_ahead(t, y):
    """When rows (q, v, …) without forces come to one of the walls at 0 and 1."""
    q, v = y[:, 0] + t * y[:, 1], y[:, 1]
    return t + jnp.where(v > 0, 1 - q, -q) / v


def between_walls(t, rows, args, which):
    """Their guard: positive between the walls."""
    q = rows[0, 0] + t * rows[0, 1]
    return q * (1 - q)


# --- a stiff DAE: z = y/2, and y → sin x at the rate of its argument -------------------------------------------------

STIFF = lh.DAE(
    lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])),
    lambda t, x, args: jnp.stack([-x[0] + x[2], -args * (x[1] - jnp.sin(x[0])), x[2] - 0.5 * x[1]]),
    n_differential=2,
)


# --- a flight whose parts a test replaces by wrong ones -------------------------------------------------------------


def flight(**parts) -> lh.EventDriven:
    """All components fall at the rate 1, and rise by 1 where the first one is zero; `parts` are taken instead."""
    usual = {
        "flow": lambda dt, t, x, a: x - dt,
        "next_event": lambda t, x, a: (x[0], 0),
        "jump": lambda t, x, a, which: x + 1.0,
        "guard": lambda t, x, a, which: x[0],
    }
    return lh.EventDriven(**(usual | parts))
