"""Hostile arguments: every verb, with one or two of its arguments replaced by what no user should give.

Right are: an answer without nan (the argument was harmless), a STATUS that says what went wrong, an error of our
family, or a ValueError that names the argument. Anything else is a failure.
"""

import contextlib
import decimal
import fractions
import functools
import signal
import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh

SECONDS = 30  # of a processor, for one call
KEY = jax.random.key(0)

HENON = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
DAMPED = lh.Flow(lambda t, x, a: jnp.stack([x[1], -x[0] - a * x[1]]))
BALL = lh.Hybrid(
    lambda t, x, a: jnp.stack([x[1], 0 * x[1] - a]),
    lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], -x[1]])),
)
CLOCK = lh.EventDriven(
    flow=lambda dt, t, x, a: jnp.stack([x[0] - dt, a * x[1]]),
    next_event=lambda t, x, a: (x[0], 0),
    jump=lambda t, x, a, which: jnp.stack([x[0] + 1.0, 0.5 * x[1]]),
    guard=lambda t, x, a, which: x[0],
)
PENDULUM = lh.Hamiltonian(lambda p, a: 0.5 * p[0] ** 2, lambda q, a: -a * jnp.cos(q[0]))


def leading(t, a):
    return jnp.diag(jnp.array([1.0, 0.0]))


def residual(t, x, a):
    return jnp.stack([-a * x[0], x[1] - x[0]])


SAW = lh.DAE(leading, residual, n_differential=1)
SLIDING = lh.filippov(
    lambda t, x, a: jnp.stack([0 * x[0] + 1.0, -1.0 - a * x[1]]),
    lambda t, x, a: jnp.stack([0 * x[0] + 1.0, 1.0 - a * x[1]]),
    lambda t, x, a: x[1],
)


def run_of(args):
    return lh.lyapunov_spectrum(HENON, [0.1, 0.2], args, t1=16, throw=False)


@functools.cache
def grid():
    """A sweep, for what refines it; made when it is first needed."""
    return lh.sweep(run_of, {"args": [0.2, 0.3]}, args=0.3, progress=None)


# The verb, its system, and arguments with which it gives an answer soon.
CALLS = {
    "spectrum of a map": (lh.lyapunov_spectrum, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "spectrum of a flow": (lh.lyapunov_spectrum, DAMPED, {"x0": [0.1, 0.2], "args": 0.3, "t1": 4.0}),
    "spectrum of a hybrid": (lh.lyapunov_spectrum, BALL, {"x0": [0.5, 0.0], "args": 1.0, "t1": 6.0}),
    "spectrum of events": (lh.lyapunov_spectrum, CLOCK, {"x0": [0.5, 1.0], "args": 0.7, "t1": 6.0}),
    "spectrum of a DAE": (lh.lyapunov_spectrum, SAW, {"x0": [0.5, 0.5], "args": 1.0, "t1": 2.0}),
    "spectrum of a pendulum": (lh.lyapunov_spectrum, PENDULUM, {"x0": [0.5, 0.5], "args": 1.0, "t1": 2.0}),
    "spectrum of sliding": (lh.lyapunov_spectrum, SLIDING, {"x0": [0.0, 0.5], "args": 0.1, "t1": 2.0}),
    "trajectory of a flow": (lh.trajectory, DAMPED, {"x0": [0.1, 0.2], "args": 0.3, "t1": 4.0, "n": 8}),
    "trajectory of a hybrid": (lh.trajectory, BALL, {"x0": [0.5, 0.0], "args": 1.0, "t1": 6.0, "n": 8}),
    "trajectory of a map": (lh.trajectory, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 8, "n": 8}),
    "tangent map of a flow": (lh.tangent_map, DAMPED, {"x0": [0.1, 0.2], "args": 0.3, "t1": 4.0}),
    "tangent map of a hybrid": (lh.tangent_map, BALL, {"x0": [0.5, 0.0], "args": 1.0, "t1": 6.0}),
    "saltation": (lh.saltation_matrix, BALL, {"t": 1.0, "x": [0.0, -1.0], "args": 1.0}),
    "jacobians": (lh.jacobians, BALL, {"t": 1.0, "x": [0.0, -1.0], "args": 1.0}),
    "two trajectories": (lh.two_trajectories, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "gali": (lh.gali, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "sali": (lh.sali, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "megno": (lh.megno, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "fli": (lh.fli, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "ofli": (lh.ofli, DAMPED, {"x0": [0.1, 0.2], "args": 0.3, "t1": 4.0}),
    "ofli2": (lh.ofli2, DAMPED, {"x0": [0.1, 0.2], "args": 0.3, "t1": 4.0}),
    "covariant vectors": (lh.covariant_vectors, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 16}),
    "intervals": (lh.spectral_intervals, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64, "window": 8, "tau": 2}),
    "svd": (lh.svd_spectrum, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 64}),
    "bounds": (lh.exponent_bounds, HENON, {"x0": [0.1, 0.2], "args": 1.4, "t1": 16}),
    "floquet": (lh.floquet, HENON, {"x0": [0.6, 0.2], "args": 1.4, "period": 1}),
    "continuation": (
        lh.continuation,
        HENON,
        {"x0": [0.6, 0.2], "args": 0.3, "over": {"args": (0.25, 0.35)}, "period": 1},
    ),
    "gradient": (lh.lyapunov_gradient, HENON, {"x0": [0.6, 0.2], "args": 0.3, "t1": 100}),
    "design": (lh.design, HENON, {"x0": [0.6, 0.2], "args": 0.3, "target": -0.5, "over": "args", "t1": 100}),
    "solutions": (lh.solutions, SLIDING, {"x0": [0.0, 0.5], "args": 0.1, "t1": 2.0}),
    "section": (lh.poincare_section, HENON, {"x0": [0.1, 0.2], "args": 1.4, "period": 1, "n": 8}),
    "diagram": (
        lh.bifurcation_diagram,
        lh.Map(lambda n, x, args: HENON.rule(n, x, args["a"])),
        {"x0": [[0.1, 0.1], [0.2, 0.2]], "args": {"a": 1.4}, "over": {"a": [0.2, 0.3]}, "t1": 16, "samples": 4},
    ),
    "consistent start": (lh.consistent_start, SAW, {"x0": [0.5, 0.0], "args": 1.0}),
    "RungeKutta": (lh.RungeKutta, None, {}),
    "Symplectic": (lh.Symplectic, None, {"dt": 0.1}),
    "TangentHamiltonian": (lh.TangentHamiltonian, None, {"variant": "cc", "dt": 0.1}),
    "HalfExplicit": (lh.HalfExplicit, None, {}),
    "ESDIRK": (lh.ESDIRK, None, {}),
    "RadauIIA": (lh.RadauIIA, None, {}),
    "Diffrax": (lh.Diffrax, None, {"solver": diffrax.Kvaerno5()}),
    "ContinuousQR": (lh.ContinuousQR, None, {"method": lh.RungeKutta()}),
    "Flow": (lh.Flow, None, {"field": DAMPED.field}),
    "Map": (lh.Map, None, {"rule": HENON.rule}),
    "Hybrid": (lh.Hybrid, None, {"fields": DAMPED, "transitions": BALL.transitions}),
    "Transition": (lh.Transition, None, {"guard": BALL.transitions[0].guard}),
    "clock": (lh.Transition, None, {"every": 1.0}),
    "Hamiltonian": (lh.Hamiltonian, None, {"kinetic": lambda p, a: p @ p, "potential": lambda q, a: q @ q}),
    "DAE": (lh.DAE, None, {"leading": leading, "residual": residual, "n_differential": 1}),
    "impact": (lh.impact, None, {"mass_matrix": lambda q, a: jnp.eye(1), "gap": lambda q, a: q[0], "restitution": 0.5}),
    "return map": (lh.return_map, BALL, {}),
    "sweep": (lh.sweep, None, {"run": run_of, "over": {"args": [0.2, 0.3]}, "args": 0.3, "progress": None}),
    "refine": (lh.refine, None, {"dataset": grid, "run": run_of, "args": 0.3, "levels": 1, "progress": None}),
    "check of a map": (lh.check, HENON, {"x0": [0.1, 0.2], "args": 0.3, "t1": 16}),
    "check of a flow": (lh.check, DAMPED, {"x0": [0.1, 0.2], "args": 0.3, "t1": 1.0}),
}


def nothing(*given, **named):
    """A function that gives None."""


NUMBERS = {
    "nan": np.nan, "inf": np.inf, "-inf": -np.inf, "1e300": 1e300, "-1e300": -1e300, "a denormal": 1e-320,
    "a small number": 1e-30, "-0.0": -0.0, "0": 0, "-1": -1, "0.5": 0.5, "10**400": 10**400, "2**63": 2**63,
    "-2**63": -(2**63), "True": True, "np.bool_": np.bool_(True), "np.int8": np.int8(3), "np.uint64": np.uint64(3),
    "np.float32": np.float32(2.0), "an array of no dimension": np.array(2.0),
    "an object array": np.array(2.0, dtype=object), "complex": 1 + 1j, "Fraction": fractions.Fraction(3, 2),
    "Decimal": decimal.Decimal("1.5"), "jnp int": jnp.asarray(2), "jnp float": jnp.asarray(2.0),
}  # fmt: skip
THINGS = {
    "text": "abc", "empty text": "", "bytes": b"abc", "number as text": "1.0", "None": None, "empty list": [],
    "empty dict": {}, "empty tuple": (), "set": {1.0}, "object": object(), "a function": nothing,
    "a list of None": [None, None], "a list of text": ["a", "b"], "a ragged list": [[1.0], [1.0, 2.0]],
    "a dict": {"a": 1.0}, "a generator": (i for i in range(0)), "a date": np.datetime64("2020-01-01"), "a key": KEY,
    "an old key": np.zeros(2, np.uint32), "a slice": slice(3), "Ellipsis": ..., "NotImplemented": NotImplemented,
}  # fmt: skip
ARRAYS = {
    "one nan": [0.1, np.nan], "one inf": [np.inf, 0.1], "huge": [1e300, -1e300], "denormals": [1e-320, 1e-320],
    "zeros": [0.0, 0.0], "ints": [1, 2], "bools": [True, False], "int8": np.array([1, 2], np.int8),
    "float32": np.array([0.5, 0.25], np.float32), "float16": np.array([0.5, 0.25], np.float16),
    "longdouble": np.array([0.5, 0.25], np.longdouble), "complex numbers": np.array([1j, 1.0]),
    "one number": [0.5], "three numbers": [0.1, 0.2, 0.3], "empty": np.zeros(0), "empty rows": np.zeros((0, 2)),
    "empty columns": np.zeros((2, 0)), "two rows": np.full((2, 2), 0.25), "many dimensions": np.zeros((1,) * 20),
    "a cube": np.zeros((2, 2, 2)), "falling": [2.0, 1.0], "equal": [1.0, 1.0], "strided": np.zeros(8)[::4],
    "big-endian": np.array([0.5, 0.25], ">f8"),
    "read only": np.broadcast_to(0.5, 2), "masked": np.ma.masked_array([0.5, 0.25], [True, False]),
    "a record": np.zeros(2, [("a", float)]),
    "a nan matrix": [[1.0, np.nan], [0.0, 1.0]], "a singular matrix": [[1.0, 1.0], [1.0, 1.0]],
    "objects": np.array([0.5, None], object),
    "dates": np.array(["2020-01-01"] * 2, "M8[D]"), "nested": [[[0.1]], [[0.2]]],
}  # fmt: skip
HOSTILE = NUMBERS | THINGS | ARRAYS
UNTOUCHED = {"self", "store", "client", "checkpoint", "progress"}  # files, machines and printing are tested elsewhere
OWN = ("throw", "resume", "names", "units", "time_unit")


@functools.cache
def names_of(call: str) -> tuple[str, ...]:
    """The arguments that a case may replace."""
    import inspect

    names = inspect.signature(CALLS[call][0]).parameters
    return tuple(name for name in names if name not in UNTOUCHED and name not in ("system", "dae"))


def case(seed: int) -> tuple[str, dict[str, str]]:
    """The call and the arguments that are replaced, by the names of their values."""
    draw = np.random.default_rng(seed)
    call = str(draw.choice(list(CALLS)))
    count = 1 if draw.random() < 0.8 else 2
    names = draw.choice(names_of(call), size=min(count, len(names_of(call))), replace=False)
    kinds = [HOSTILE, HOSTILE, NUMBERS, ARRAYS]
    return call, {str(name): str(draw.choice(list(kinds[draw.integers(4)]))) for name in names}


def verdict(call: str, replaced: dict[str, str]) -> str | None:
    """None where the answer is right, else what is wrong with it."""
    verb, system, arguments = CALLS[call]
    given = arguments | {name: HOSTILE[value] for name, value in replaced.items()}
    given = {name: grid() if value is grid else value for name, value in given.items()}
    try:
        with limited(), warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", category=UserWarning)  # notes for the reader
            warnings.filterwarnings("error", message="A JAX array is being set as static")
            warnings.filterwarnings("ignore", category=RuntimeWarning)  # NumPy's, of overflow: nan and inf say it too
            warnings.filterwarnings("ignore", message="Python iterable type 'generator'")  # jax.tree's; it is a leaf
            result = verb(*(() if system is None else (system,)), **given)
            return wrong(result)
    except lh.LyaphybridError:
        return None
    except Exception as error:
        if in_user_code(error):
            return None
        if not isinstance(error, ValueError):
            return f"{type(error).__name__}: {str(error)[:300]}"
        said = str(error).lower()
        return None if any(word in said for name in replaced for word in words(name)) else f"names nothing: {error}"


def in_user_code(error: BaseException) -> bool:
    """Whether it was raised while a function of the system ran: what its parameters may be is for that to say."""
    trace = error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if code.co_filename == __file__ and code.co_name not in ("verdict", "wrong", "late"):
            return True
        trace = trace.tb_next
    return False


FUNCTIONS = ("rule", "field", "guard", "reset", "flow", "next_event", "jump", "residual", "leading", "energy")
SAID = {
    "x0": ("start", "orders", "x of shape", "x: shape", "x's shape", "deviation vectors"),
    "x": ("x's shape",), "args": FUNCTIONS,
    "fields": ("field",),
    "over": ("parameter",), "t1": ("needs key=",),
    "transitions": ("transition",), "times": ("block",), "t": ("(t, x)",),
    "method": ("lh.rungekutta",),
}  # fmt: skip


def words(name: str) -> tuple[str, ...]:
    """By which words an error may name an argument."""
    return (*SAID.get(name, ()), name, name.replace("_", " "))


def wrong(result) -> str | None:
    """What is wrong with a result: nan where the status says that all went well."""
    if not np.all(np.asarray(getattr(result, "status", 1)) == 0):
        return None
    if np.any(np.asarray(getattr(result, "skipped", 0)) > 0):  # two trajectories: it is said, and warned of
        return None
    names = ("exponents", "exponent", "x", "matrix")
    values = [np.asarray(getattr(result, name)) for name in names if hasattr(result, name)]
    return "nan with the status ok" if any(np.any(np.isnan(value)) for value in values) else None


@contextlib.contextmanager
def limited(seconds: float = SECONDS):
    """An error where a call takes too long; Ctrl-C would only end the run within."""

    def late(*_):
        raise TimeoutError(f"no answer within {seconds:g} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def failures(seeds) -> dict[int, str]:
    """What is wrong, by seed."""
    found = {}
    for seed in seeds:
        call, replaced = case(seed)
        said = verdict(call, replaced)
        if said:
            found[seed] = f"{call}, {replaced}: {said}"
    return found
