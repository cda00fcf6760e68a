"""Bad arguments are refused before anything is computed, with what was given, what was wanted and what to do."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import flight

DECAY = lh.Flow(lambda t, x, a: -x)
HENON = lh.zoo.henon_map()


def guard(t, x, a):
    """Falls where the first component does."""
    return x[0]


TWO_MODES = lh.Hybrid({"up": DECAY, "down": DECAY}, lh.Transition(guard, source="up", target="down"))

CONSTRUCTIONS = {
    "field must be a function": lambda: lh.Flow(3.0),
    "rule must be a function": lambda: lh.Map("x"),
    "exactly one of guard": lh.Transition,
    "got guard=<function guard": lambda: lh.Transition(guard, every=1.0),
    "guard must be a function": lambda: lh.Transition(1.0),
    "reset must be a function": lambda: lh.Transition(guard, 1.0),
    "when must be a function": lambda: lh.Transition(guard, when=True),
    "direction must be": lambda: lh.Transition(guard, direction=2),
    "period, must be positive": lambda: lh.Transition(every=-1.0),
    "target must be None": lambda: lh.Transition(guard, target=1.5),
    "max_cascade must be": lambda: lh.Hybrid(DECAY, lh.Transition(guard), max_cascade=0),
    "must be lh.Transition objects": lambda: lh.Hybrid(DECAY, [guard]),
    "Unknown mode 'sideways'": lambda: lh.Hybrid(DECAY, lh.Transition(guard, source="sideways")),
    "as tangent": lambda: lh.Hybrid(DECAY, lh.Transition(guard), tangent={"stick": guard}),
    "at least one Transition": lambda: lh.Hybrid(DECAY, []),
    "exactly one Transition, with a reset": lambda: lh.Hybrid(None, lh.Transition(guard)),
    "The field of mode 'flow'": lambda: lh.Hybrid(2.0, lh.Transition(guard)),
    "exactly one of next_event": lambda: lh.EventDriven(guard, None, guard, guard),
    "next_event must be": lambda: lh.EventDriven(guard, 1.0, guard, guard),
    "schedule must be an lh.Schedule": lambda: lh.EventDriven(guard, None, guard, guard, schedule=guard),
    "touch must be": lambda: lh.Schedule(guard, guard, guard, guard, None),
    "Unknown tableau": lambda: lh.RungeKutta("euler9"),
    "control must be": lambda: lh.RungeKutta(control="y"),
    "give a fixed step": lambda: lh.RungeKutta("rk4"),
    "rtol must be positive": lambda: lh.RungeKutta(rtol=-1.0),
    "dt must be positive": lambda: lh.RungeKutta(dt=0.0),
    "max_step = 0.2 is for adaptive steps": lambda: lh.RungeKutta(dt=0.1, max_step=0.2),
    "max_step must be positive": lambda: lh.RungeKutta(max_step=-1.0),
    "must be a diffrax solver": lambda: lh.Diffrax("Kvaerno5"),
    "with an error estimate": lambda: lh.Diffrax(diffrax.Euler()),
    "atol must be positive and finite; got '1e-9'": lambda: lh.Diffrax(diffrax.Kvaerno5(), atol="1e-9"),
    "rtol must be positive and finite; got nan": lambda: lh.RungeKutta(rtol=float("nan")),
}


@pytest.mark.parametrize("message", CONSTRUCTIONS)
def test_constructions_are_refused(message):
    """At construction."""
    with pytest.raises(ValueError, match=message):
        CONSTRUCTIONS[message]()


CALLS = {
    "system must be": (guard, [1.0], {}),
    "x0 must be real": (DECAY, [1j], {}),
    "x0 must have shape": (DECAY, 1.0, {}),
    "x0 must be finite": (DECAY, [float("nan")], {}),
    "t1, a length, must be positive": (DECAY, [1.0], {"t1": -1.0}),
    "transient, a length, must be positive": (DECAY, [1.0], {"transient": -1.0}),
    "clock must be one of": (DECAY, [1.0], {"clock": "weeks"}),
    "averaging must be one of": (DECAY, [1.0], {"averaging": "none"}),
    "orthonormalise must be one of": (DECAY, [1.0], {"orthonormalise": "qr"}),
    "blocks must be": (DECAY, [1.0], {"blocks": 1}),
    "k must be an integer of at least 1": (DECAY, [1.0], {"k": 0}),
    "k must be at most n = 1": (DECAY, [1.0], {"k": 2}),
    "frame must have shape": (DECAY, [1.0, 2.0], {"frame": jnp.ones((3, 1))}),
    "linearly independent": (DECAY, [1.0, 2.0], {"frame": jnp.ones((2, 2))}),
    "every must be positive": (DECAY, [1.0], {"every": 0}),
    "for a system whose steps are counted": (HENON.system, [0.1, 0.1], {"every": ("time", 0.1)}),
    r"got \('jumps', 2\)": (DECAY, [1.0], {"every": ("jumps", 2)}),
    "target_stderr, a standard error": (DECAY, [1.0], {"target_stderr": 0.0}),
    "max_steps must be an integer of at least 1": (DECAY, [1.0], {"max_steps": 0}),
    "replicates must be an integer of at least 2": (DECAY, [1.0], {"replicates": 1}),
    "replicates needs key": (DECAY, [1.0], {"replicates": 2}),
    "replicates perturbs one start": (DECAY, [[1.0], [2.0]], {"replicates": 2, "key": jax.random.key(0)}),
    "times must be": (DECAY, [1.0], {"times": "linear"}),
    "positive, increasing array": (DECAY, [1.0], {"times": [2.0, 1.0]}),
    "times must end at t1": (DECAY, [1.0], {"times": [0.5, 2.0]}),
    "say which one it starts in": (TWO_MODES, [1.0], {}),
    "Unknown mode 'left'": (TWO_MODES, [1.0], {"mode": "left"}),
    "mode 5 is out of range": (TWO_MODES, [1.0], {"mode": 5}),
    "needs a method such as": (DECAY, [1.0], {"method": "dopri5"}),
    "A map is iterated": (HENON.system, [0.1, 0.1], {"method": lh.RungeKutta()}),
    "t0 must be a finite number": (DECAY, [1.0], {"t0": float("inf")}),
    "got True": (DECAY, [1.0], {"t1": True}),
    "x0 must be an array of numbers; got 'abc'": (DECAY, "abc", {}),
    "an lh.Flow has no jumps": (DECAY, [1.0], {"clock": "jumps"}),
    "got 5": (DECAY, [1.0], {"replicates": 3, "key": 5}),
}


@pytest.mark.parametrize("message", CALLS)
def test_calls_are_refused(message):
    """Before computing."""
    system, x0, keywords = CALLS[message]
    with pytest.raises(ValueError, match=message):
        lh.lyapunov_spectrum(system, x0, HENON.args, **({"t1": 1.0} | keywords))


BOUNCES = lh.Hybrid(DECAY, lh.Transition(lambda t, x, args: x[0] - 0.5, lambda t, x, args: 2 * x))
UNCOUNTED = {
    "spectrum": lambda: lh.lyapunov_spectrum(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5),
    "of jumps": lambda: lh.lyapunov_spectrum(BOUNCES, [1.0], t1=10.5, clock="jumps"),
    "trajectory": lambda: lh.trajectory(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5),
    "tangent map": lambda: lh.tangent_map(HENON.system, [0.1, 0.1], HENON.args, t1=0.5),
    "two trajectories": lambda: lh.two_trajectories(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5),
    "gali": lambda: lh.gali(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5),
    "megno": lambda: lh.megno(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5),
    "covariant vectors": lambda: lh.covariant_vectors(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5),
    "intervals": lambda: lh.spectral_intervals(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5, window=10, tau=0),
    "gradient": lambda: lh.lyapunov_gradient(HENON.system, [0.1, 0.1], HENON.args, t1=1000.5, key=jax.random.key(0)),
}


@pytest.mark.parametrize("call", UNCOUNTED)
def test_iterations_and_jumps_are_whole_numbers(call):
    with pytest.raises(ValueError, match=r"t1 counts (iterations|jumps) here: it must be a whole number; got \d+\.5"):
        UNCOUNTED[call]()


def test_the_transient_of_a_map_is_whole_too():
    options = {"t1": 100, "transient": 10.5}
    with pytest.raises(ValueError, match="transient counts iterations here"):
        lh.lyapunov_spectrum(HENON.system, [0.1, 0.1], HENON.args, **options)
    with pytest.raises(ValueError, match="transient counts iterations here"):
        lh.sali(HENON.system, [0.1, 0.1], HENON.args, **options)


@pytest.mark.slow
def test_kinds_of_plots_are_listed():
    spectrum = lh.lyapunov_spectrum(HENON.system, [0.1, 0.1], HENON.args, t1=100)
    with pytest.raises(ValueError, match=r"kind must be one of \('spectrum', 'convergence'\); got 'foo'"):
        spectrum.plot(kind="foo")


def jump(guard=guard, **parts):
    return lh.Hybrid(DECAY, lh.Transition(guard, **parts))


def two(target):
    return lh.Hybrid({"up": DECAY, "down": DECAY}, lh.Transition(guard, source="up", target=target))


FUNCTIONS = {
    "field must return an array of x's shape": lh.Flow(lambda t, x, a: x[0]),
    "Put components together": lh.Flow(lambda t, x, a: [x[0], x[1]]),
    "field must return float64, the type of x; it returned int": lh.Flow(lambda t, x, a: jnp.array([1, 2])),
    r"field is called with \(t, x, args\): too many": lh.Flow(lambda t, x: x),
    "rule must return an array": lh.Map(lambda n, x, a: x[0]),
    "guard of transition 0 must return a scalar or .*shape \\(2, 2\\)": jump(lambda t, x, a: jnp.ones((2, 2))),
    "crosses zero; got shape .* of bool": jump(lambda t, x, a: x[0] > 0),
    "crosses zero; got None": jump(lambda t, x, a: None),
    "reset of transition 0 must return an array": jump(reset=lambda t, x, a: x[:1]),
    "reset of transition 0 is called with .*which": jump(lambda t, x, a: x, reset=lambda t, x, a: x),
    "when of transition 0 must return a single truth value": jump(when=lambda t, x, a: x > 0),
    "target of transition 0 must return the index": two(lambda t, x, a: x[0]),
    "every of transition 0 must be positive and finite; got -1.0": lh.Hybrid(
        DECAY, lh.Transition(every=lambda a: -1.0)
    ),
    "tangent of mode 'flow' must return": lh.Hybrid(
        DECAY, lh.Transition(guard), tangent={"flow": lambda t, x, a, dx: dx[:1]}
    ),
    "flow must return an array": flight(flow=lambda dt, t, x, a: x[0]),
    "next_event must return": flight(next_event=lambda t, x, a: x[0]),
    "dt of next_event must be a float": flight(next_event=lambda t, x, a: (jnp.asarray(1), 0)),
    "which of next_event must be an integer": flight(next_event=lambda t, x, a: (x[0], 0.5)),
    "jump must return an array": flight(jump=lambda t, x, a, which: x[0]),
    "guard must return a single number": flight(guard=lambda t, x, a, which: x),
}


@pytest.mark.parametrize("message", FUNCTIONS)
def test_functions_that_return_something_else_are_named(message):
    """By what they were asked for."""
    system = FUNCTIONS[message]
    with pytest.raises(ValueError, match=message):
        lh.lyapunov_spectrum(system, [1.0, 2.0], t1=1.0, mode="up" if len(modes_of(system)) > 1 else None)


def test_a_start_of_fewer_digits_than_the_field():
    field = lh.Flow(lambda t, x, a: x.astype(jnp.float64))
    message = "returned float64. Give x0 as float64, or"
    with pytest.warns(UserWarning, match="x0 is float32"), pytest.raises(ValueError, match=message):
        lh.lyapunov_spectrum(field, jnp.array([1.0, 2.0], jnp.float32), t1=1.0)


def modes_of(system):
    return getattr(system, "mode_names", ("flow",))


def test_trajectory_and_tangent_map_refuse_too():
    """The same checks stand before them."""
    with pytest.raises(ValueError, match="t1, a length of time"):
        lh.trajectory(DECAY, [1.0], t1=0.0)
    with pytest.raises(ValueError, match="number of samples"):
        lh.trajectory(DECAY, [1.0], t1=1.0, n=0)
    with pytest.raises(ValueError, match="Use jax.vmap"):
        lh.tangent_map(DECAY, [[1.0]], t1=1.0)


OSCILLATOR = lh.Flow(lambda t, x, a: jnp.stack([x[1], a["mu"] * (1 - x[0] ** 2) * x[1] - x[0]]))
MU, WITHIN = {"mu": 1.0}, {"method": lh.ContinuousQR(lh.RungeKutta())}
BOX, CELLS = [[1.0, 0.0], [2.0, 1.0]], {"shape": (1, 1)}
READ_COLUMNS = {
    "tangent_map": lambda x0: lh.tangent_map(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
    "ftle_field": lambda x0: lh.ftle_field(OSCILLATOR, BOX, MU, t1=1.0, **CELLS, **WITHIN),
    "angle_field": lambda x0: lh.angle_field(OSCILLATOR, BOX, MU, transient=1.0, **CELLS, **WITHIN),
    "floquet": lambda x0: lh.floquet(OSCILLATOR, x0, MU, **WITHIN),
    "phase_response": lambda x0: lh.phase_response(OSCILLATOR, x0, MU, **WITHIN),
    "continuation": lambda x0: lh.continuation(OSCILLATOR, x0, MU, over={"mu": (0.5, 2.0)}, **WITHIN),
    "bifurcation_curve": lambda x0: lh.bifurcation_curve(
        lh.Flow(lambda t, x, a: a["b"] * OSCILLATOR.field(t, x, a)),
        x0, {"mu": 1.0, "b": 1.0}, over={"mu": (0.5, 2.0), "b": (0.5, 2.0)}, **WITHIN,
    ),
    "implicit": lambda x0: lh.lyapunov_gradient(OSCILLATOR, x0, MU, t1=9.0, algorithm="implicit", **WITHIN),
    "covariant_vectors": lambda x0: lh.covariant_vectors(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
    "svd_spectrum": lambda x0: lh.svd_spectrum(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
    "exponent_bounds": lambda x0: lh.exponent_bounds(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
    "gali": lambda x0: lh.gali(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
    "megno": lambda x0: lh.megno(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
    "ofli2": lambda x0: lh.ofli2(OSCILLATOR, x0, MU, t1=1.0, **WITHIN),
}  # fmt: skip


@pytest.mark.parametrize("verb", READ_COLUMNS)
def test_what_reads_columns_refuses_continuous_qr(verb):
    """Its columns stay orthonormal: taken for a tangent map they would say that nothing grows."""
    with pytest.raises(ValueError, match=f"^{verb} needs columns with their growth .*: give the method within it"):
        READ_COLUMNS[verb]([2.0, 0.0])


LOGISTIC = lh.Map(lambda n, x, a: a["r"] * x * (1 - x))
FOUND_BY_RANDOM_ARGUMENTS = {
    "args must hold numbers.*dtype=object": lambda: lh.continuation(
        LOGISTIC, [0.6], {"r": 2.5, "more": np.array([None, 1.0], object)}, over={"r": (2.0, 3.0)}, period=1
    ),
    "args must hold numbers.*datetime64": lambda: lh.design(
        LOGISTIC, [0.6], {"r": 2.5, "more": np.datetime64("2026-11-28")}, -0.1, over={"r": (2.0, 3.0)}, t1=100
    ),
    r"x0 must have shape \(n,\).*got \(1, 1, 1\)": lambda: lh.design(
        LOGISTIC, np.full((1, 1, 1), 0.6), {"r": 2.5}, -0.1, over={"r": (2.0, 3.0)}, t1=100
    ),
    "method.*got 'abc'": lambda: lh.lyapunov_gradient(DECAY, [1.0], 2.5, t1=100, method="abc"),
}


@pytest.mark.parametrize("message", FOUND_BY_RANDOM_ARGUMENTS)
def test_what_random_arguments_have_found(message):
    """By `python -m tests.fuzz arguments`: errors of JAX, and a text taken for the old name of an algorithm."""
    with pytest.raises(ValueError, match=message):
        FOUND_BY_RANDOM_ARGUMENTS[message]()


@pytest.mark.slow
def test_a_period_in_few_bits_is_a_number_like_others():
    """200 periods of an int8 are not counted in 8 bits."""
    how = {"over": {"r": [2.8, 3.2]}, "t1": 200, "transient": 200, "samples": 8}
    found = lh.bifurcation_diagram(LOGISTIC, [[0.1], [0.9]], {"r": 0.0}, period=np.int8(2), **how)
    assert found.labels[:, 0].tolist() == ["P1w0", "P1w0"]  # of the second iterate
