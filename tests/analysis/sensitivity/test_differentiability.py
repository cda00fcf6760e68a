"""Derivatives, forward and reverse, through what is computed of short and regular motion, jumps included."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import native
from lyaphybrid._jax import reverse_mode

TIGHT = lh.RungeKutta("dopri5", rtol=1e-10, atol=1e-12)


def falling(t, x, args):
    return jnp.stack([x[1], -args["gravity"] - args["drag"] * x[1]])


def floor_of(t, x, args):
    return x[0] - args["height"] - 0.1 * jnp.sin(t)


def struck(t, x, args):
    speed = 0.1 * jnp.cos(t)
    return jnp.stack([x[0], speed - args["restitution"] * (x[1] - speed)])


BALL = lh.Hybrid(falling, lh.Transition(guard=floor_of, reset=struck))
ARGS = {"gravity": 1.0, "drag": 0.1, "height": 0.2, "restitution": 0.7}
START = jnp.array([1.0, 0.3])


def ends(args, x0):
    """The state and its derivative after two impacts on a floor that moves."""
    found = lh.tangent_map(BALL, x0, args, t1=4.0, method=TIGHT)
    return found.x, found.matrix


def with_one(name, value):
    return ARGS | {name: value}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(ARGS))
def test_motion_and_tangents_with_respect_to_parameters(name):
    """Of guards and resets too; against central differences."""
    assert int(lh.tangent_map(BALL, START, ARGS, t1=4.0, method=TIGHT).jumps) == 2
    value, step = jnp.asarray(ARGS[name]), 1e-5
    of_one = jax.jit(lambda value: ends(with_one(name, value), START))
    slopes = jax.jvp(of_one, (value,), (jnp.ones(()),))[1]
    for slope, high, low in zip(slopes, of_one(value + step), of_one(value - step), strict=True):
        assert_allclose(slope, (high - low) / (2 * step), rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_the_derivative_of_a_trajectory_is_the_tangent_map():
    def end(x0):
        return lh.trajectory(BALL, x0, ARGS, t1=4.0, n=1, method=TIGHT).x[-1]

    assert_allclose(jax.jacfwd(end)(START), ends(ARGS, START)[1], rtol=1e-9)


def test_the_derivative_of_a_saltation_matrix():
    """Of a ball that meets a floor at rest at speed v, S₂₁ = (1 + r) g/v."""

    def entry(gravity):
        still = lh.Transition(guard=lambda t, x, g: x[0], reset=lambda t, x, g: jnp.stack([x[0], -0.7 * x[1]]))
        ball = lh.Hybrid(lambda t, x, g: jnp.stack([x[1], -g]), still)
        return lh.saltation_matrix(ball, 0.0, jnp.array([0.0, -2.0]), gravity)[1, 0]

    value, slope = jax.jvp(entry, (jnp.asarray(9.0),), (jnp.ones(()),))
    assert_allclose(value, slope * 9.0, rtol=1e-12)
    assert_allclose(abs(slope), 1.7 / 2.0, rtol=1e-12)


SHEAR = np.array([[1.0, 0.5], [0.2, 1.3]])


def stretched(t, x, rate):
    return SHEAR @ (jnp.stack([rate, -rate]) * jnp.linalg.solve(SHEAR, x))


def rates_of_stretching(rate):
    options = {"t1": 20.0, "transient": 40.0, "method": TIGHT, "blocks": 2, "throw": False}
    return lh.lyapunov_spectrum(lh.Flow(stretched), jnp.zeros(2), rate, **options).exponents


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_the_derivative_of_exponents_of_regular_motion(derivative):
    """Rates of a linear system in sheared coordinates; its columns align at a rate that has a derivative too."""
    assert_allclose(jax.jit(derivative(rates_of_stretching))(jnp.asarray(0.7)), [1, -1], rtol=1e-6)


@pytest.mark.slow
def test_reverse_derivatives_of_motion_and_tangents():
    """Through two impacts on a floor that moves: by rows as by columns."""

    def outcome(args, x0):
        x, matrix = ends(args, x0)
        return jnp.sum(x) + jnp.sum(jnp.sin(matrix))

    args = jax.tree.map(jnp.asarray, ARGS)
    forward = jax.jit(jax.jacfwd(outcome, argnums=(0, 1)))(args, START)
    reverse = jax.grad(outcome, argnums=(0, 1))(args, START)
    jax.tree.map(functools.partial(assert_allclose, rtol=1e-11), reverse, forward)


@pytest.mark.slow
def test_reverse_derivatives_of_a_trajectory():
    def end(x0):
        return lh.trajectory(BALL, x0, ARGS, t1=4.0, n=3, method=TIGHT).x[-1]

    assert_allclose(jax.jacrev(end)(START), ends(ARGS, START)[1], rtol=1e-9)


def test_the_reverse_derivative_of_a_saltation_matrix():
    still = lh.Transition(guard=lambda t, x, g: x[0], reset=lambda t, x, g: jnp.stack([x[0], -0.7 * x[1]]))
    ball = lh.Hybrid(lambda t, x, g: jnp.stack([x[1], -g]), still)

    def entry(gravity, speed):
        return lh.saltation_matrix(ball, 0.0, jnp.stack([jnp.zeros(()), -speed]), gravity)[1, 0]

    slopes = jax.grad(entry, argnums=(0, 1))(jnp.asarray(9.0), jnp.asarray(2.0))
    assert_allclose(np.abs(slopes), [1.7 / 2, 1.7 * 9 / 4], rtol=1e-12)


@pytest.mark.slow
def test_the_memory_of_a_reverse_pass_does_not_grow_with_the_steps():
    """Of x(t) = cos ωt after 100 steps and after 100 000, by one program, whose memory is known beforehand."""

    def end(omega, t1):
        swing = lh.Flow(lambda t, x, omega: jnp.stack([x[1], -(omega**2) * x[0]]))
        return lh.tangent_map(swing, jnp.array([1.0, 0.0]), omega, t1=t1, method=lh.RungeKutta("rk4", dt=0.01)).x[0]

    one, many = jnp.asarray(1.0), jnp.asarray(1000.0)
    program = jax.jit(jax.grad(end)).lower(one, one).compile()
    assert program.memory_analysis().temp_size_in_bytes < 1e6
    assert_allclose(program(one, one), -np.sin(1.0), rtol=1e-8)
    assert_allclose(program(one, many), -1000 * np.sin(1000.0), rtol=1e-5)


@pytest.mark.slow
def test_what_a_function_closes_over_has_forward_derivatives():
    def end(omega):
        swing = lh.Flow(lambda t, x, args: jnp.stack([x[1], -(omega**2) * x[0]]))
        return lh.tangent_map(swing, jnp.array([1.0, 0.0]), None, t1=1.0, method=TIGHT).x[0]

    assert_allclose(jax.jacfwd(end)(jnp.asarray(1.0)), -np.sin(1.0), rtol=1e-8)


def _iterated(x, factor, turns):
    """A loop within a loop, with what it closes over and with integers in its state."""

    def inner(y):
        step = lambda state: (state[0] + 1, state[1] + 0.1 * jnp.sin(factor * state[1]))  # noqa: E731
        return reverse_mode.checkpointed(lambda state: state[0] < 3, step, (0, y))[1]

    def step(state):
        i, y, total = state
        y = jnp.cos(inner(y)) * factor + jnp.asarray(i, y.dtype) * 1e-3
        return i + 1, y, total + y * y

    return reverse_mode.checkpointed(lambda state: state[0] < turns, step, (0 * turns, x, jnp.zeros(())))[2]


def _scanned(x, factor, turns):
    def step(state, i):
        y, total = state
        for _ in range(3):
            y = y + 0.1 * jnp.sin(factor * y)
        y = jnp.cos(y) * factor + jnp.asarray(i, y.dtype) * 1e-3
        return (y, total + y * y), None

    return jax.lax.scan(step, (x, jnp.zeros(())), jnp.arange(turns))[0][1]


@pytest.mark.slow
def test_a_loop_backwards_whatever_its_number_of_turns():
    """Few, as many as there are checkpoints, one more, and thousands: one program, whose memory is the same."""
    arguments = jnp.asarray(0.3), jnp.asarray(0.9)
    backwards = native.compile(jax.grad(_iterated, argnums=(0, 1)), *arguments, jnp.asarray(3))
    room = reverse_mode.CHECKPOINTS // 2
    for turns in (0, 1, 2, 3, room - 1, room, room + 1, 2 * room, 2 * room + 1, 500, 5000):
        wanted = native.compile(jax.grad(functools.partial(_scanned, turns=turns), argnums=(0, 1)), *arguments)
        assert_allclose(backwards(*arguments, np.asarray(turns)), wanted(*arguments), rtol=1e-9, atol=1e-12)


@pytest.mark.slow_cases("40000")
@pytest.mark.parametrize("turns", [40, 2000, 40_000])
def test_how_often_a_turn_is_computed_again(turns):
    """By where checkpoints are put, without the loop's work: three times over at most, up to forty thousand turns."""
    distance = native.compile(reverse_mode._distance, np.int32(2), np.int32(2))
    most, apart = reverse_mode.CHECKPOINTS, 1
    while turns > apart * most // 2:
        apart *= 2
    kept, computed = list(range(0, turns, apart)), 0
    for now in range(turns - 1, -1, -1):
        at = kept[-1]
        due = at + int(distance(np.int32(most + 1 - len(kept)), np.int32(now + 1 - at)))
        while at < now:
            at, computed = at + 1, computed + 1
            if at == due:
                kept.append(at)
                due = at + int(distance(np.int32(most + 1 - len(kept)), np.int32(now + 1 - at)))
        if kept[-1] == now:
            kept.pop()
    assert computed < 3 * turns


def test_results_that_nobody_differentiates_do_not_spoil_the_others():
    """The derivative of a root at zero is infinite: times a cotangent of zero it would be nan."""
    function = reverse_mode.both_ways(*[lambda x: (jnp.sum(x * x), jnp.sqrt(jnp.sum(x)))] * 2)
    assert_allclose(jax.grad(lambda x: function(x)[0])(jnp.zeros(3)), np.zeros(3))


def _growth(p):
    """Of the logistic map from p[0], over two steps, with the rate p[1]: a run as short as can be."""
    logistic = lh.Map(lambda n, x, rate: rate * x * (1 - x))
    return lh.lyapunov_spectrum(logistic, p[:1], p[1], t1=2, blocks=2, throw=False).exponents[0]


def _growth_exactly(p):
    x, rate = p
    return jnp.log(jnp.abs(rate * (1 - 2 * x) * rate * (1 - 2 * rate * x * (1 - x)))) / 2


PLACE = jnp.array([0.3, 0.8])


@pytest.mark.slow
def test_second_derivatives_of_a_run():
    found = jax.jacfwd(jax.jacfwd(_growth))(PLACE)
    assert_allclose(found, jax.hessian(_growth_exactly)(PLACE), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("first", [jax.jacfwd, jax.grad])
def test_second_derivatives_that_are_not_offered_say_what_to_take(first):
    second = jax.grad if first is jax.jacfwd else jax.jacfwd
    with pytest.raises(RuntimeError, match=r"In place of .* take jax\.jacfwd\(jax\.jacfwd\(f\)\)"):
        jax.make_jaxpr(second(lambda p: jnp.sum(first(_growth)(p))))(PLACE)


@pytest.mark.slow
def test_the_reverse_derivative_of_runs_side_by_side():
    places = jnp.stack([PLACE, jnp.array([0.2, 2.5])])
    found = jax.grad(lambda places: jnp.sum(jax.vmap(_growth)(places)))(places)
    assert_allclose(found, jax.vmap(jax.grad(_growth_exactly))(places), rtol=1e-12)


def _closed_over(rate):
    """The same run, of a rule that closes over its rate."""
    return lh.lyapunov_spectrum(lh.Map(lambda n, x, _: rate * x * (1 - x)), [0.3], t1=2, blocks=2).exponents[0]


@pytest.mark.slow
def test_reverse_derivatives_of_what_a_function_closes_over_are_refused():
    with pytest.raises(RuntimeError, match=r"close over a value .* let the functions take it from args"):
        jax.make_jaxpr(jax.grad(_closed_over))(0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "within"),
    [("native", lambda f: f), ("native", jax.jit), ("xla", lambda f: f)],
    ids=["plain", "jit", "xla"],
)
def test_second_derivatives_of_what_a_function_closes_over_say_what_to_take(monkeypatch, engine, within):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", engine)
    with pytest.raises(RuntimeError, match=r"jax\.jacfwd\(jax\.jacfwd\(f\)\)"):
        jax.make_jaxpr(jax.hessian(within(_closed_over)))(0.8)


@pytest.mark.slow
def test_second_derivatives_of_what_a_function_closes_over():
    found = jax.jacfwd(jax.jacfwd(_closed_over))(0.8)
    assert_allclose(found, jax.hessian(_growth_exactly)(PLACE)[1, 1], rtol=1e-12)
