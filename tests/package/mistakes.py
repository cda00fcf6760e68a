"""Mistakes of users, and the words that the answer to each must contain: what was given, what is wanted, what to do.

`FUNCTIONS` are mistakes in a function of the system, whose line the answer must name; `ARGUMENTS` are all others.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import diffrax
import equinox
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special

import lyaphybrid as lh
from elastic_ball import bounce, falling, height
from examples import flight


class Mistake(NamedTuple):
    """A call that cannot be answered, and words of the answer."""

    call: Callable
    words: tuple[str, ...]


def swing(t, x, args):
    return jnp.stack([x[1], -x[0]])


SWING, HENON = lh.Flow(swing), lh.zoo.henon_map()
BALL = lh.Hybrid(falling, lh.Transition(height, bounce))
DAMPED = lh.Flow(lambda t, x, a: jnp.stack([x[1], -a["k"] * x[0] - a["c"] * x[1]]))
POINT, PAIR = {"k": 1.0, "c": 0.1}, [1.0, 0.5]


def flow(field, args=None, x0=PAIR):
    return functools.partial(lh.lyapunov_spectrum, lh.Flow(field), x0, args, t1=1.0)


def iterated(rule, args=None):
    return functools.partial(lh.lyapunov_spectrum, lh.Map(rule), PAIR, args, t1=10)


def jumping(args=None, every=None, guard=height, **parts):
    guard = None if every else guard
    transition = lh.Transition(guard, **({"reset": bounce} | parts), every=every)
    return functools.partial(lh.trajectory, lh.Hybrid(falling, transition), PAIR, args, t1=1.0)


def switching(target):
    system = lh.Hybrid({"up": falling, "down": falling}, lh.Transition(height, source="up", target=target))
    return functools.partial(lh.trajectory, system, PAIR, t1=1.0, mode="up")


def hamiltonian(kinetic=lambda p, a: p @ p / 2, potential=lambda q, a: q @ q / 2, x0=PAIR):
    return functools.partial(lh.lyapunov_spectrum, lh.Hamiltonian(kinetic, potential), x0, t1=1.0)


def constrained(leading, residual):
    return functools.partial(lh.lyapunov_spectrum, lh.DAE(leading, residual, 1), [1.0, 1.0], t1=1.0)


def first_row(t, a):
    return jnp.diag(jnp.array([1.0, 0.0]))


def flown(**parts):
    return functools.partial(lh.lyapunov_spectrum, flight(**parts), PAIR, t1=1.0)


def swept(run, args=None, **over):
    over, args = over or {"k": [0.0, 0.5, 1.0]}, {"k": 0.0, "c": 0.1} if args is None else args
    return functools.partial(lh.sweep, run, over, args=args, progress=False)


# Functions as users write them.


def with_if(t, x, args):
    if x[0] > 0:
        return -x
    return x


def with_while(t, x, args):
    while x[0] > 1:
        x = x - 1
    return x


def changing(t, x, args):
    x[0] = -x[1]
    return x


def changing_numpy(t, x, args):
    dx = np.zeros(2)
    dx[0] = x[1]
    return dx


def without_return(t, x, args):
    jnp.stack([x[1], -x[0]])


def loop(t, x, args):
    return sum((args["rate"] * x for _ in range(args["terms"])), 0 * x)


def two_of_three(t, x, args):
    a, b = args
    return a * x + b


def three_of_two(t, x, args):
    x, y, z = x
    return jnp.stack([y - x, x * z, z])


class Oscillator:
    def field(self, t, x, args):
        return -x


JNP = "import jax.numpy as jnp"
MODES = ("jnp.where(condition, one, other)", "lh.Hybrid")
BACKWARDS_ONLY = jax.custom_vjp(lambda x: x * x)
BACKWARDS_ONLY.defvjp(lambda x: (x * x, x), lambda x, g: (2 * x * g,))


def bounced_by_noise(key, size):
    """The end of a fall that a random impact interrupts."""
    system = lh.EventDriven(
        flow=lambda dt, t, x, a: jnp.array([x[0] + x[1] * dt - dt**2 / 2, x[1] - dt]),
        next_event=lambda t, x, a: (x[1] + jnp.sqrt(x[1] ** 2 + 2 * x[0]), 0),
        jump=lambda t, x, a, which: jnp.array([0 * x[0], a["size"] * jax.random.uniform(a["key"]) - x[1]]),
        guard=lambda t, x, a, which: x[0],
    )
    return lh.trajectory(system, [1.0, 0.0], {"key": key, "size": size}, t1=2.0, n=1).x[-1, 1]


def kicked_by_noise(key, size):
    """The end of x' = −x with a random kick at t = 1."""
    kick = lh.Transition(every=1.0, reset=lambda t, x, a: x + a["size"] * jax.random.normal(a["key"], (1,)))
    system = lh.Hybrid(lambda t, x, a: -x, kick)
    return lh.trajectory(system, [1.0], {"key": key, "size": size}, t1=1.5, n=1).x[-1, 0]


FUNCTIONS = {
    "np.cos": Mistake(flow(lambda t, x, a: jnp.stack([x[1], -np.cos(x[0])])), ("`np.cos(x[0])`", "jnp.cos for", JNP)),
    "np.array": Mistake(flow(lambda t, x, a: np.array([x[1], -x[0]])), ("`np.array([x[1], -x[0]])`", "jnp.array", JNP)),
    "np.where": Mistake(flow(lambda t, x, a: np.where(x > 0, -x, x)), ("`np.where(", "jnp.where for np.where")),
    "scipy": Mistake(
        flow(lambda t, x, a: -scipy.special.expit(x)), ("scipy.special.expit(x)", "jax.scipy.special.expit for")
    ),
    "math.sin": Mistake(
        flow(lambda t, x, a: jnp.stack([x[1], -math.sin(x[0])])), ("`math.sin(x[0])`", "jnp.sin for math.sin", JNP)
    ),
    "float": Mistake(flow(lambda t, x, a: float(x[0]) * x), ("`float(x[0])`", "need a number", "leave float() out")),
    "int": Mistake(flow(lambda t, x, a: x * int(t)), ("`int(t)`", "need a number", "jnp.floor")),
    "range": Mistake(
        flow(loop, {"rate": 1.0, "terms": 3}), ("range(args[", "must not be in args", "functools.partial")
    ),
    "if": Mistake(flow(with_if), ("`x[0] > 0`", "one answer at once", *MODES)),
    "while": Mistake(flow(with_while), ("`x[0] > 1`", "while", *MODES)),
    "and": Mistake(flow(lambda t, x, a: x * ((x[0] > 0) and (x[1] > 0))), ("`(x[0] > 0) and", "and, or, not", *MODES)),
    "max": Mistake(flow(lambda t, x, a: -x * max(x[0], 0.0)), ("`max(x[0], 0.0)`", "max, min", "jnp.maximum")),
    "boolean index": Mistake(flow(lambda t, x, a: 0 * x + x[x > 0].sum()), ("`x[x > 0]`", "jnp.where")),
    "assignment": Mistake(flow(changing), ("changed in place", "x.at[0].set(value)", "jnp.stack")),
    "undefined name": Mistake(flow(lambda t, x, a: -omega * x), ("`omega`", "'omega' is not defined")),
    "matrix too large": Mistake(flow(lambda t, x, a: jnp.ones((3, 3)) @ x), ("(3,) and (2,)", "x: shape (2,)")),
    "no args": Mistake(flow(lambda t, x, a: -a["k"] * x), ('`a["k"]`', "args is None", "to be given, args=…")),
    "no args in a product": Mistake(flow(lambda t, x, a: -a * x), ("`-a`", "args is None", "to be given, args=…")),
    "wrong key": Mistake(flow(lambda t, x, a: -a["k"] * x, {"kappa": 1.0}), ("no 'k'", "args has 'kappa'")),
    "key as attribute": Mistake(
        flow(lambda t, x, a: -a.k * x, {"k": 1.0}), ("`a.k`", "args is a dict", "args['name']")
    ),
    "entry that is None": Mistake(flow(lambda t, x, a: -a["k"] * x, {"k": None}), ('`-a["k"]`', "args: {'k': None}")),
    "tuple too short": Mistake(flow(lambda t, x, a: -a[2] * x, (1.0, 2.0)), ("`a[2]`", "has 2 entries", "from 0")),
    "array too short": Mistake(flow(lambda t, x, a: -a[2] * x, jnp.ones(2)), ("entry 2", "(2,)", "entries are 0 to 1")),
    "state too short": Mistake(
        flow(lambda t, x, a: jnp.stack([x[1], x[2]])),
        ("entry 2", "entries are 0 to 1"),
    ),
    "before the first": Mistake(flow(lambda t, x, a: x[-3] * x), ("entry -3", "shape (2,)", "entries are 0 to 1")),
    "write beyond the end": Mistake(flow(lambda t, x, a: x.at[2].set(0.0)), ("sets entry 2", "change nothing")),
    "list of indices": Mistake(flow(lambda t, x, a: x[jnp.array([1, 2])]), ("entry 2", "entries are 0 to 1")),
    "args unpacked": Mistake(flow(two_of_three, (1.0, 2.0, 3.0)), ("too many values", "args: (a number, a number")),
    "state unpacked": Mistake(flow(three_of_two), ("not enough values", "x: shape (2,)")),
    "args of another length": Mistake(flow(lambda t, x, a: -a * x, jnp.ones(3)), ("(3,), (2,)", "args: shape (3,)")),
    "x before t": Mistake(
        flow(lambda x, t, a: jnp.stack([x[1], -x[0]])), ("(x, t, …)", "time comes first", "(t, x, args)")
    ),
    "guard by if": Mistake(jumping(guard=lambda t, x, a: 1.0 if x[0] > 0 else -1.0), ("guard of transition 0", *MODES)),
    "guard by np": Mistake(
        jumping(guard=lambda t, x, a: np.sin(x[0])), ("guard of transition 0", "jnp.sin for np.sin")
    ),
    "guard of args": Mistake(jumping(guard=lambda t, x, a: x[0] - a["h"]), ("guard of transition 0", "args is None")),
    "assignment to an array of NumPy": Mistake(
        flow(changing_numpy), ("NumPy holds numbers", "x.at[0].set(value)", "jnp.stack")
    ),
    "reset in place": Mistake(jumping(reset=changing), ("reset of transition 0", "x.at[0].set(value)")),
    "when by np": Mistake(
        jumping(when=lambda t, x, a: np.sign(x[0]) > 0), ("when of transition 0", "jnp.sign for np.sign")
    ),
    "kinetic by np": Mistake(
        hamiltonian(lambda p, a: np.dot(p, p) / 2), ("kinetic of the field", "jnp.dot for np.dot")
    ),
    "potential by math": Mistake(
        hamiltonian(potential=lambda q, a: math.cos(q[0])), ("potential of the field", "jnp.cos for math.cos")
    ),
    "residual by np": Mistake(
        constrained(first_row, lambda t, x, a: jnp.stack([-x[0], x[1] - np.sin(x[0])])),
        ("residual of the field", "jnp.sin for np.sin"),
    ),
    "rule by np": Mistake(iterated(lambda n, x, a: np.mod(x + 0.1, 1.0)), ("rule fails", "jnp.mod for np.mod")),
    "rule by if": Mistake(iterated(with_if), ("rule fails", "jnp.where(condition, one, other)")),
    "clock without args": Mistake(
        jumping(every=lambda a: 2 * jnp.pi / a["omega"]), ("every of transition 0", "args is None")
    ),
    "next event by if": Mistake(
        flown(next_event=lambda t, x, a: (x[0] if x[0] > 0 else x[1], 0)), ("next_event fails", "jnp.where")
    ),
    "float in a run": Mistake(
        swept(lambda a: lh.lyapunov_spectrum(DAMPED, PAIR, {"k": float(a["k"]), "c": 0.1}, t1=1.0)),
        ("run fails", "leave float() out"),
    ),
    "if in a run": Mistake(swept(lambda a: 1.0 if a["k"] > 0 else 2.0), ("run fails", "jnp.where")),
    "np in a run": Mistake(swept(lambda a: np.cos(a["k"])), ("run fails", "jnp.cos for np.cos")),
    "wrong key in a run": Mistake(swept(lambda a: 2.0 * a["q"]), ("no 'q'", "args has 'k', 'c'")),
    "wrong length in a run": Mistake(
        swept(lambda a: lh.lyapunov_spectrum(DAMPED, PAIR, a, t1=-1.0)), ("run fails", "t1, a length", "got -1.0")
    ),
}

ARGUMENTS = {
    "no return": Mistake(flow(without_return), ("x's shape (2,)", "returned None", "without `return`")),
    "complex field": Mistake(
        flow(lambda t, x, a: jax.lax.complex(x, x)), ("returned complex128", "real and the imaginary part")
    ),
    "float32 field": Mistake(flow(lambda t, x, a: x.astype(jnp.float32)), ("returned float32", "float64")),
    "tuple of a reset": Mistake(jumping(reset=lambda t, x, a: (x[0], -x[1])), ("reset of transition 0", "jnp.stack")),
    "SciPy's f(t, y)": Mistake(flow(lambda t, y: -y), ("(t, x, args)", "too many", "lambda t, x, args: f(t, x)")),
    "an argument more": Mistake(flow(lambda t, x, a, b: -x), ("(t, x, args)", "'b'", "all of these arguments")),
    "method without object": Mistake(flow(Oscillator.field), ("(t, x, args)", "missing", "'args'")),
    "target by name": Mistake(switching(lambda t, x, a: "down"), ("returns a str", "index of a mode")),
    "leading of x": Mistake(
        constrained(lambda t, x, a: jnp.eye(2), lambda t, x, a: x), ("leading of the field", "(t, args)")
    ),
    "kinetic without args": Mistake(hamiltonian(lambda p: p @ p / 2), ("kinetic of the field", "(p, args)")),
    "kinetic of each": Mistake(hamiltonian(lambda p, a: p**2 / 2), ("must return a number", "got shape (1,)")),
    "momenta missing": Mistake(hamiltonian(x0=[1.0, 0.0, 0.5]), ("as many positions as momenta", "x0 has 3")),
    "jump without which": Mistake(flown(jump=lambda t, x, a: x + 1.0), ("jump is called with (t, x, args, which)",)),
    "x0 and args swapped": Mistake(flow(swing, PAIR, x0={"k": 1.0}), ("got {'k': 1.0}", "comes before args")),
    "arrays swapped": Mistake(
        flow(lambda t, x, a: a * jnp.sum(x), jnp.ones(3)), ("shape (3,)", "are x0 and args in each other's place?")
    ),
    "x0 missing": Mistake(flow(swing, x0=None), ("x0 must be an array of numbers", "got None", "such as [1.0, 0.0]")),
    "x0 as a column": Mistake(
        functools.partial(lh.trajectory, SWING, [[1.0], [0.5]], t1=1.0), ("x0 must have shape (n,)", "got (2, 1)")
    ),
    "words in args": Mistake(flow(swing, {"name": "left"}), ("args must hold numbers", "got 'left'", "functools")),
    "object as args": Mistake(flow(swing, Oscillator()), ("args must hold numbers", "Oscillator", "functools")),
    "solver of diffrax": Mistake(
        functools.partial(flow(swing), method=diffrax.Tsit5()), ("got Tsit5()", "lh.Diffrax(diffrax.Tsit5())")
    ),
    "method without brackets": Mistake(
        functools.partial(flow(swing), method=lh.RungeKutta), ("got <class", "brackets: RungeKutta()")
    ),
    "method as a word": Mistake(
        functools.partial(flow(swing), method="RK45"), ("got 'RK45'", "lh.RungeKutta('dopri5')")
    ),
    "solver without brackets": Mistake(
        functools.partial(lh.Diffrax, diffrax.Kvaerno5), ("got <class", "brackets: diffrax.Kvaerno5()")
    ),
    "tolerance without name": Mistake(functools.partial(lh.RungeKutta, 1e-6), ("1e-06", "by name: rtol=…")),
    "span of times": Mistake(functools.partial(flow(swing), t1=(0.0, 9.0)), ("got (0.0, 9.0)", "t0=a, t1=b − a")),
    "t1 as a word": Mistake(functools.partial(flow(swing), t1="100"), ("t1", "positive and finite", "got '100'")),
    "samples as an array": Mistake(
        functools.partial(lh.trajectory, SWING, PAIR, t1=1.0, n=[0.0, 1.0]), ("n, the number of", "got [0.0, 1.0]")
    ),
    "diffrax term as a field": Mistake(
        functools.partial(lh.Flow, diffrax.ODETerm(swing)), ("got ODETerm", "lh.Flow(term.vector_field)")
    ),
    "diffrax term as a system": Mistake(
        functools.partial(lh.lyapunov_spectrum, diffrax.ODETerm(swing), PAIR, t1=1.0),
        ("got ODETerm", "lh.Flow(term.vector_field)"),
    ),
    "field that is called": Mistake(lambda: lh.Flow(swing(0.0, jnp.ones(2), None)), ("got Array", "f, not f(…)")),
    "problem as a system": Mistake(
        functools.partial(lh.lyapunov_spectrum, HENON, PAIR, t1=10),
        ("got Problem", "problem.system", ".spectrum(t1=…)"),
    ),
    "list of fields": Mistake(
        functools.partial(lh.Hybrid, [SWING, SWING], lh.Transition(height)), ("Modes have names", '{"up": one')
    ),
    "source as a function": Mistake(
        functools.partial(lh.Transition, height, source=height), ("source must be", "the name of a mode")
    ),
    "splitting of a field": Mistake(
        functools.partial(flow(swing), method=lh.Symplectic(dt=0.1)),
        ("lh.Hamiltonian(kinetic, potential)", "another field"),
    ),
    "point off the guard": Mistake(
        functools.partial(lh.saltation_matrix, BALL, 0.0, [1.0, 0.0]),
        ("not on the guard", "its value is 1", "x_before"),
    ),
    "no such transition": Mistake(
        functools.partial(lh.saltation_matrix, BALL, 0.0, [0.0, -1.0], transition=2), ("from 0 to 0", "got 2")
    ),
    "saltation of a flow": Mistake(
        functools.partial(lh.saltation_matrix, SWING, 0.0, PAIR), ("needs a system that jumps", "got Flow")
    ),
    "return map of a flow": Mistake(functools.partial(lh.return_map, SWING), ("needs an lh.Hybrid", "got Flow")),
    "consistent start of a flow": Mistake(
        functools.partial(lh.consistent_start, SWING, PAIR), ("needs an lh.DAE", "got Flow")
    ),
    "order beyond n": Mistake(
        functools.partial(lh.gali, HENON.system, PAIR, HENON.args, t1=10, orders=[3]), ("from 2 to 2", "got [3]")
    ),
    "window beyond t1": Mistake(
        functools.partial(lh.spectral_intervals, HENON.system, PAIR, HENON.args, t1=10, window=20, tau=1),
        ("at most t1 = 10", "got 20"),
    ),
    "forcing without period": Mistake(
        functools.partial(lh.floquet, lh.Flow(lambda t, x, a: jnp.stack([x[1], jnp.cos(t) - x[0]])), PAIR),
        ("depends on time", "give period"),
    ),
    "no such parameter": Mistake(
        functools.partial(lh.continuation, DAMPED, PAIR, POINT, over={"q": (0.0, 1.0)}, period=1.0),
        ("c, k", "got ['q']"),
    ),
    "range without the start": Mistake(
        functools.partial(lh.continuation, HENON.system, PAIR, HENON.args, over={"a": (0.1, 0.2)}, period=1),
        ("a is 1.4", "must be in over, from 0.1 to 0.2"),
    ),
    "parameter without range": Mistake(
        functools.partial(lh.continuation, HENON.system, PAIR, HENON.args, "a", period=1), ("over={'a': (low, high)}",)
    ),
    "gradient by nothing": Mistake(
        functools.partial(lh.lyapunov_gradient, SWING, PAIR, None, t1=10.0), ("no floating-point number", "got None")
    ),
    "target as a word": Mistake(
        functools.partial(lh.design, DAMPED, PAIR, POINT, target="max", over="k", t1=10.0), ("target", "got 'max'")
    ),
    "diagram over a list": Mistake(
        functools.partial(lh.bifurcation_diagram, DAMPED, [PAIR], POINT, over=[0.0, 1.0], t1=10, samples=4),
        ("a dictionary with one parameter", "got [0.0, 1.0]"),
    ),
    "section as a word": Mistake(
        functools.partial(lh.poincare_section, SWING, PAIR, section="x = 0", n=4), ("must be a function", "got 'x = 0'")
    ),
    "run of two arguments": Mistake(swept(lambda a, b: a), ("run is called with (args)", "'b'")),
    "run without return": Mistake(swept(lambda a: None), ("must return a Spectrum", "got None")),
    "args of a sweep by place": Mistake(
        functools.partial(lh.sweep, lambda a: a, {"k": 1.0}, over={"k": [1.0]}),
        ("multiple values", "by name points=…, args=…"),
    ),
    "sweep of another name": Mistake(swept(lambda a: a, q=[1.0]), ("'q' is no entry of args", "args has c, k")),
    "sweep over one number": Mistake(swept(lambda a: a["k"], k=0.5), ("at least one value", "got array(0.5)")),
    "sweep too large": Mistake(
        swept(lambda a: a["k"], k=np.zeros(10**6), c=np.zeros(10**6)), ("1000000 × 1000000", "memory of this machine")
    ),
    "samples beyond memory": Mistake(
        functools.partial(lh.trajectory, SWING, PAIR, t1=1.0, n=10**12), ("n, the number of samples", "smaller", "GiB")
    ),
    "blocks beyond memory": Mistake(functools.partial(flow(swing), blocks=10**12), ("blocks", "smaller", "GiB")),
    "replicates beyond memory": Mistake(
        functools.partial(flow(swing), replicates=10**12, key=jax.random.key(0)), ("replicates", "smaller", "GiB")
    ),
    "problem of another name": Mistake(lambda: lh.zoo.lorenz, ("no 'lorenz'", "nearest first", "lorenz63")),
    "parameter of another name": Mistake(lambda: lh.zoo.lorenz63(rh=28.0), ("no parameter 'rh'", "nearest is 'rho'")),
    "parameters without names": Mistake(lambda: lh.zoo.lorenz63(10.0), ("by name", "rho=28", "got (10.0,)")),
    "parameter as a word": Mistake(lambda: lh.zoo.lorenz63(rho="28"), ("rho must be a finite real", "got '28'")),
    "tolerance of the verb": Mistake(
        functools.partial(flow(swing), rtol=1e-6), ("argument 'rtol'", "lh.RungeKutta(rtol=…)")
    ),
    "step of the verb": Mistake(
        functools.partial(lh.trajectory, SWING, PAIR, t1=1.0, dt=0.01),
        ("argument 'dt'", "dt=…)", "n=… is a number of"),
    ),
    "end of time": Mistake(
        functools.partial(lh.lyapunov_spectrum, SWING, PAIR, t_end=9.0), ("argument 't_end'", "t1=…")
    ),
    "seed": Mistake(
        functools.partial(flow(swing), replicates=4, seed=1), ("argument 'seed'", "key=jax.random.key(seed)")
    ),
    "keyword with a slip": Mistake(functools.partial(flow(swing), transients=1.0), ("did you mean transient=?",)),
    "keyword of nobody": Mistake(
        functools.partial(flow(swing), colour="red"), ("argument 'colour'", "it takes system, x0")
    ),
    "arguments by place": Mistake(
        lambda: lh.bifurcation_diagram(DAMPED, "k", [0.1, 0.2], PAIR, POINT),
        ("by place only system, x0, args", "over=…"),
    ),
    "length by place": Mistake(lambda: lh.trajectory(SWING, PAIR, None, 10.0), ("by place only", "by name t1=…")),
    "one start, and random ones": Mistake(
        functools.partial(lh.bifurcation_diagram, DAMPED, PAIR, POINT, over={"k": [0.1]}, period=1.0),
        ("the two corners of a box", "got shape (2,)", "starts=[[…], …]", "directions=('up', 'down')"),
    ),
    "module as parameters": Mistake(
        flow(lambda t, x, network: network(x), equinox.nn.MLP(2, 2, 4, 1, key=jax.random.key(0))),
        ("equinox.partition(module, equinox.is_array)", "equinox.combine(args, rest)"),
    ),
    "derivative backwards only": Mistake(
        functools.partial(lh.lyapunov_spectrum, lh.Flow(lambda t, x, a: BACKWARDS_ONLY(x)), PAIR, t1=1.0),
        ("no forward derivative", "jax.custom_jvp in place of jax.custom_vjp"),
    ),
    "typed key in a gradient": Mistake(
        functools.partial(jax.grad(lambda s: kicked_by_noise(jax.random.key(0), s)), 1.0),
        ("a typed key", "jax.random.key_data(key)", "jax.jacfwd"),
    ),
    "typed key in a gradient of an event-driven system": Mistake(
        functools.partial(jax.grad(lambda s: bounced_by_noise(jax.random.key(0), s)), 1.0),
        ("a typed key", "jax.random.key_data(key)", "jax.jacfwd"),
    ),
    "orbit under grad": Mistake(
        functools.partial(jax.grad(lambda k: lh.floquet(DAMPED, PAIR, POINT | {"k": k}, period=1.0).exponents[0]), 1.0),
        ("decides from values", "lh.lyapunov_gradient"),
    ),
    "check under jit": Mistake(
        functools.partial(jax.jit(lambda k: len(lh.check(DAMPED, PAIR, POINT | {"k": k}).findings)), 1.0),
        ("check decides from values", "Call it outside"),
    ),
    "figure of another name": Mistake(
        lambda: lh.trajectory(SWING, PAIR, t1=1.0).plot.time(),
        ("no figure 'time'", ".plot(), .plot.phase()", ".raster()"),
    ),
    "component of a figure": Mistake(
        lambda: lh.trajectory(SWING, PAIR, t1=1.0).plot(component=1), ("component=1", "components=[…]")
    ),
    "size of a figure": Mistake(
        lambda: lh.trajectory(SWING, PAIR, t1=1.0).plot.phase(figsize=(3, 3)), ("pyplot.subplots(figsize=…)",)
    ),
    "step too long": Mistake(
        functools.partial(
            lh.lyapunov_spectrum, lh.Flow(lambda t, x, a: -(x**3)), [9.0], t1=50.0, method=lh.RungeKutta("rk4", dt=0.5)
        ),
        ("nonfinite", "a fixed step dt is too long", "halve it", "It stood at t ="),
    ),
    "parameter that is nan": Mistake(
        flow(lambda t, x, a: -a * x, float("nan")), ("nonfinite", "a parameter is nan", "It stood at t = 0")
    ),
}
