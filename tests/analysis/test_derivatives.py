"""Saltation matrices against central differences of real flows in closed form; Jacobians against formulas."""

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

import automata as shapes
import lyaphybrid as lh

BEFORE, AFTER = 0.05, 0.07  # how far from the event the real flow starts and ends

# --- real flows: affine, across an event, in closed form and in NumPy -----------------------------


def affine_flow(a, b, dt):
    """(matrix, vector) with x(t + dt) = matrix @ x(t) + vector, for x' = a x + b."""
    n = len(b)
    generator = np.zeros((n + 1, n + 1))
    generator[:n, :n], generator[:n, n] = a, b
    exponential = expm(generator * dt)
    return exponential[:n, :n], exponential[:n, n]


def move(mode, x, dt):
    matrix, vector = affine_flow(*mode, dt)
    return matrix @ x + vector


def crossing_time(mode, guard, x, t, guess):
    """The time of the crossing near `guess` of the flow that starts at (t, x), by Newton's method."""
    a, b = mode
    h, h_rate = guard
    for _ in range(50):
        at = move(mode, x, guess - t)
        step = -h(guess, at) / h_rate(guess, at, a @ at + b)
        guess += step
        if abs(step) < 1e-15:
            break
    return guess


def through(modes, guard, resets, t_event, x):
    """From x at t_event - BEFORE over the event and its resets to t_event + AFTER."""
    start = t_event - BEFORE
    t = crossing_time(modes[0], guard, x, start, t_event)
    x = move(modes[0], x, t - start)
    for reset in resets:
        x = reset(t, x)
    return move(modes[1], x, t_event + AFTER - t)


def differences(function, x, step=1e-4):
    """The Jacobian of a function by central differences of order six."""
    columns = []
    for e in np.eye(len(x)) * step:
        ends = [function(x + k * e) - function(x - k * e) for k in (1, 2, 3)]
        columns.append((45 * ends[0] - 9 * ends[1] + ends[2]) / (60 * step))
    return np.stack(columns, axis=1)


def real_saltation(modes, guard, resets, t, x):
    """S from differences of the real flow, carried back to the event along both flows."""
    back, start = affine_flow(*modes[0], BEFORE)[0], move(modes[0], x, -BEFORE)
    whole = differences(lambda x: through(modes, guard, resets, t, x), start)
    return np.linalg.inv(affine_flow(*modes[1], AFTER)[0]) @ whole @ np.linalg.inv(back)


def random_case(rng, n, resets=1):
    """Two affine modes, a moving guard through a point (t, x), time-dependent affine resets."""
    case = {
        "A": rng.normal(size=(2, n, n)),
        "b": rng.normal(size=(2, n)),
        "c": rng.normal(size=n),
        "wave": rng.normal(size=3) * np.array([0.5, 2.0, 1.0]),  # a sin(w t + p)
        "R": rng.normal(size=(resets, n, n)),
        "r": rng.normal(size=(resets, n)),
        "s": rng.normal(size=(resets, n)),
        "u": 2 * rng.normal(size=resets),
    }
    t, x = rng.uniform(0, 10), rng.normal(size=n)
    a, w, p = case["wave"]
    case["d"] = np.array(-(case["c"] @ x + a * np.sin(w * t + p)))
    rate = case["c"] @ (case["A"][0] @ x + case["b"][0]) + a * w * np.cos(w * t + p)
    return case, t, x, rate


def parts(case):
    """The same in NumPy: modes, guard and resets of `real_saltation`."""
    a, w, p = case["wave"]
    c, d = case["c"], case["d"]
    guard = (
        lambda t, x: c @ x + d + a * np.sin(w * t + p),
        lambda t, x, f: c @ f + a * w * np.cos(w * t + p),
    )
    resets = [
        lambda t, x, i=i: case["R"][i] @ x + case["r"][i] + case["s"][i] * np.cos(case["u"][i] * t)
        for i in range(len(case["R"]))
    ]
    return list(zip(case["A"], case["b"], strict=True)), guard, resets


def field(q):
    return lambda t, x, args: jnp.sum(args["A"][q] * x[None, :], axis=1) + args["b"][q]


def guard(t, x, args):
    a, w, p = args["wave"]
    return jnp.sum(args["c"] * x) + args["d"] + a * jnp.sin(w * t + p)


def reset(i):
    def jump(t, x, args):
        moved = jnp.sum(args["R"][i] * x[None, :], axis=1) + args["r"][i]
        return moved + args["s"][i] * jnp.cos(args["u"][i] * t)

    return jump


MODES = {"before": field(0), "after": field(1)}
FALLING = lh.Hybrid(MODES, lh.Transition(guard, reset(0), source="before", target="after"))
CASCADE = lh.Hybrid(
    MODES,
    [
        lh.Transition(guard, reset(0), source="before", target="before"),
        lh.Transition(lambda t, x, args: x[0], reset(1), source="before", target="before"),
        lh.Transition(lambda t, x, args: x[1], reset(2), source="before", target="after"),
    ],
)


def assert_close(ours, real, tolerance=1e-7):
    assert_allclose(ours, real, rtol=0, atol=tolerance * max(1.0, np.abs(real).max()))


# --- laws -----------------------------------------------------------------------------------------


@pytest.mark.slow
@hypothesis.given(st.integers(0, 2**32 - 1))
@hypothesis.settings(max_examples=100)
def test_saltation_is_the_derivative_of_the_real_flow(seed):
    case, t, x, rate = random_case(np.random.default_rng(seed), 3)
    hypothesis.assume(abs(rate) > 0.3)
    ours = lh.saltation_matrix(FALLING, t, x, jax.tree.map(jnp.asarray, case), mode="before")
    assert_close(ours, real_saltation(*parts(case), t, x))


@pytest.mark.slow
@hypothesis.given(st.integers(0, 2**32 - 1))
@hypothesis.settings(max_examples=30)
def test_in_a_cascade_the_instant_belongs_to_the_first_guard(seed):
    case, t, x, rate = random_case(np.random.default_rng(seed), 3, resets=3)
    hypothesis.assume(abs(rate) > 0.3)
    args = jax.tree.map(jnp.asarray, case)
    ours = lh.saltation_matrix(CASCADE, t, x, args, transition=(0, 1, 2))
    assert_close(ours, real_saltation(*parts(case), t, x))
    single = lh.saltation_matrix(CASCADE, t, x, args, transition=0)
    modes, moving, resets = parts(case)
    assert_close(single, real_saltation([modes[0], modes[0]], moving, resets[:1], t, x))


def test_a_clock_crosses_by_the_derivative_of_the_reset():
    case, t, x, _ = random_case(np.random.default_rng(1), 3)
    system = lh.Hybrid(MODES, lh.Transition(every=0.5, reset=reset(0), source="before", target="after"))
    assert_allclose(lh.saltation_matrix(system, t, x, jax.tree.map(jnp.asarray, case)), case["R"][0], rtol=1e-14)


@pytest.mark.slow
def test_the_engine_applies_this_matrix():
    """M(t1) = Φ S Φ, and the event log gives the points."""
    rng, found = np.random.default_rng(5), 0
    for _ in range(12):
        case, t, x, rate = random_case(rng, 3)
        args, modes = jax.tree.map(jnp.asarray, case), parts(case)[0]
        if rate > -0.3:
            continue
        start = move(modes[0], x, -BEFORE)
        span = {"t0": t - BEFORE, "t1": BEFORE + AFTER, "mode": "before"}
        events = lh.trajectory(FALLING, start, args, n=1, **span).events
        if len(events) != 1:  # it has met its guard on the way
            continue
        s = lh.saltation_matrix(FALLING, events.t[0], events.x_before[0], args, mode=events.mode_before[0])
        whole = affine_flow(*modes[1], AFTER)[0] @ np.asarray(s) @ affine_flow(*modes[0], BEFORE)[0]
        assert_close(lh.tangent_map(FALLING, start, args, **span).matrix, whole, 1e-8)
        found += 1
    assert found >= 3


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["beyond", "on", "chain3"])
def test_cascades_of_the_reference_automata(automata, variant):
    """S of each cascade, between exponentials of the linear flows, makes up the reference's M(T)."""
    checked, found = 0, [s for s in automata["systems"] if (s["family"], s["variant"]) == ("e", variant)]
    for system in found[:3]:  # each has its own sequences of transitions, and each sequence compiles
        group = automata["groups"][system["group"]]
        matrix, event = _product_of_saltations(group, system)
        scale = max(1.0, system["amp"]) * max(1.0, np.abs(system["M"]).max())
        assert_allclose(matrix, system["M"], rtol=0, atol=1e-8 * scale, err_msg=f"system {system['id']}")
        checked += int(np.sum(event["casc"] == 1))
    assert checked > 0


def _product_of_saltations(group, member):
    """Φ S_m Φ … S_1 Φ with the reference's events; a cascade is one S."""
    a, event, row = group["A"][member["pos"]], member["ev"], member["pos"]
    hybrid = shapes.automaton(*a.shape[:1], group["c"].shape[2])
    args = shapes.arguments(group, row)
    matrix, t, firsts = np.eye(a.shape[1]), member["t0"], np.flatnonzero(event["casc"] == 0)
    for i, until in zip(firsts, [*firsts[1:], len(event["t"])], strict=True):
        jumps = range(i, until)
        both = [group["dir"][row][event["q"][e], event["j"][e]] == 0 for e in jumps]
        transitions = [2 * int(event["q"][e]) + int(b) for e, b in zip(jumps, both, strict=True)]
        which = [int(event["j"][e]) for e in jumps]
        single = len(transitions) == 1
        s = lh.saltation_matrix(
            hybrid,
            event["t"][i],
            event["xm"][i],
            args,
            transition=transitions[0] if single else tuple(transitions),
            which=which[0] if single else tuple(which),
            mode=int(event["q"][i]),
        )
        matrix = np.asarray(s) @ expm(a[event["q"][i]] * (event["t"][i] - t)) @ matrix
        t = event["t"][i]
    last = event["mode"][-1] if len(event["t"]) else member["mode0"]
    return expm(a[last] * (member["T"] - t)) @ matrix, event


# --- vector guards and event-driven systems -------------------------------------------------------


def walls(t, x, args):
    """A breathing box: distances to four moving walls, all falling."""
    half = 1.0 + 0.2 * jnp.sin(args["w"] * t)
    return jnp.stack([half + x[0], half - x[0], half + x[1], half - x[1]])


def rebound(t, x, args, which):
    speed = 0.2 * args["w"] * jnp.cos(args["w"] * t)
    outward = jnp.array([-1.0, 1.0, -1.0, 1.0])[which]
    across = jnp.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])[which]
    relative = jnp.sum(across * x[2:]) - outward * speed
    return jnp.concatenate([x[:2], x[2:] - (1 + args["r"]) * relative * across])


def drift(t, x, args):
    return jnp.stack([x[2], x[3], -0.1 * x[2], args["g"] + 0 * x[3]])


BOX = lh.Hybrid(drift, lh.Transition(walls, rebound))
BOX_ARGS = {"w": 1.3, "r": 0.9, "g": -0.3}


@pytest.mark.parametrize("which", range(4))
def test_vector_guards(which):
    t, w, r = 0.7, BOX_ARGS["w"], BOX_ARGS["r"]
    half = 1 + 0.2 * np.sin(w * t)
    outward, axis = (-1.0, 1.0, -1.0, 1.0)[which], which // 2
    x = np.array([0.1, 0.2, 0.3, -0.4])
    x[axis], x[2 + axis] = outward * half, outward * 1.5
    a = np.zeros((4, 4))
    a[0, 2] = a[1, 3] = 1.0
    a[2, 2] = -0.1
    mode = (a, np.array([0, 0, 0, BOX_ARGS["g"]]))
    speed = lambda t: 0.2 * w * np.cos(w * t)  # noqa: E731
    moving = (
        lambda t, x: 1 + 0.2 * np.sin(w * t) - outward * x[axis],
        lambda t, x, f: speed(t) - outward * f[axis],
    )

    def bounce(t, x):
        x = x.copy()
        x[2 + axis] -= (1 + r) * (x[2 + axis] - outward * speed(t))
        return x

    real = real_saltation([mode, mode], moving, [bounce], t, x)
    assert_close(lh.saltation_matrix(BOX, t, x, BOX_ARGS, which=which), real)
    jacobian = lh.jacobians(BOX, t, x, BOX_ARGS)
    assert jacobian.Dg[0].shape == (4, 4, 4)
    assert jacobian.Dh[0].shape == (4, 4)
    assert jacobian.dg_dt[0].shape == (4, 4)
    assert jacobian.dh_dt[0].shape == (4,)
    assert_allclose(jacobian.Dh[0][which], -outward * np.eye(4)[axis])


def fly(dt, t, x, g):
    return jnp.stack([x[0] + x[1] * dt - 0.5 * g * dt**2, x[1] - g * dt])


def land(t, x, g):
    """A floor that rises with the speed 0.1."""
    height, speed = x[0] - 0.1 * t, x[1] - 0.1
    return (speed + jnp.sqrt(speed**2 + 2 * g * height)) / g, 0


BALL = lh.EventDriven(
    flow=fly,
    next_event=land,
    jump=lambda t, x, g, which: jnp.stack([0 * x[0] + 0.1 * t, -0.8 * x[1] + 0.18 + 0.05 * jnp.sin(t)]),
    guard=lambda t, x, g, which: x[0] - 0.1 * t,
)


def test_event_driven():
    t, g = 1.2, 2.0
    x = np.array([0.12, -1.1])
    mode = (np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, -g]))
    moving = (lambda t, x: x[0] - 0.1 * t, lambda t, x, f: f[0] - 0.1)
    jump = lambda t, x: np.array([0.1 * t, -0.8 * x[1] + 0.18 + 0.05 * np.sin(t)])  # noqa: E731
    real = real_saltation([mode, mode], moving, [jump], t, x)
    assert_close(lh.saltation_matrix(BALL, t, x, g, which=0), real, 1e-9)
    jacobian = lh.jacobians(BALL, t, x, g)
    assert_allclose(jacobian.Df, mode[0])
    assert_allclose(jacobian.Dg[0], [[0, 0], [0, -0.8]])
    assert_allclose(jacobian.Dh[0], [1, 0])
    assert_allclose(jacobian.dg_dt[0], [0.1, 0.05 * np.cos(t)])
    assert_allclose(jacobian.dh_dt[0], -0.1)


def test_event_driven_with_a_tree_of_integers():
    system = lh.EventDriven(
        flow=fly,
        next_event=lambda t, x, g: (land(t, x, g)[0], {"wall": 0}),
        jump=lambda t, x, g, which: BALL.jump(t, x, g, which["wall"]),
        guard=lambda t, x, g, which: BALL.guard(t, x, g, which["wall"]),
    )
    t, x = 1.2, np.array([0.12, -1.1])
    ours = lh.saltation_matrix(system, t, x, 2.0, which={"wall": 0})
    assert_allclose(ours, lh.saltation_matrix(BALL, t, x, 2.0, which=0), rtol=1e-15)
    assert_allclose(lh.jacobians(system, t, x, 2.0).Dg[0], lh.jacobians(BALL, t, x, 2.0).Dg[0])


# --- Jacobians ------------------------------------------------------------------------------------


def test_jacobians_of_two_modes():
    case, t, x, _ = random_case(np.random.default_rng(2), 3)
    args = jax.tree.map(jnp.asarray, case)
    for q, name in enumerate(MODES):
        found = lh.jacobians(FALLING, t, x, args, mode=name)
        assert_allclose(found.Df, case["A"][q], rtol=1e-14)
        assert_allclose(found.Dg[0], case["R"][0], rtol=1e-14)
        assert_allclose(found.Dh[0], case["c"], rtol=1e-14)
        a, w, p = case["wave"]
        assert_allclose(found.dh_dt[0], a * w * np.cos(w * t + p), rtol=1e-12)
        assert_allclose(found.dg_dt[0], -case["s"][0] * case["u"][0] * np.sin(case["u"][0] * t), rtol=1e-12)


def test_jacobians_make_up_the_saltation_matrix():
    case, t, x, _ = random_case(np.random.default_rng(3), 3)
    args = jax.tree.map(jnp.asarray, case)
    j = jax.tree.map(np.asarray, lh.jacobians(FALLING, t, x, args, mode="before"))
    before, after = (np.asarray(f(t, x, args)) for f in (field(0), lambda t, x, a: field(1)(t, reset(0)(t, x, a), a)))
    jump = after - j.Dg[0] @ before - j.dg_dt[0]
    expected = j.Dg[0] + np.outer(jump, j.Dh[0]) / (j.dh_dt[0] + j.Dh[0] @ before)
    assert_allclose(lh.saltation_matrix(FALLING, t, x, args), expected, rtol=1e-10)


def test_jacobians_of_maps_flows_clocks_and_jumps():
    henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
    found = lh.jacobians(henon, 0.0, [0.5, 0.1], 1.4)
    assert_allclose(found.Df, [[-1.4, 1.0], [0.3, 0.0]])
    assert found.Dg == found.Dh == ()
    assert_allclose(lh.jacobians(lh.Flow(lambda t, x, a: -a * t * x), 2.0, [1.0], 3.0).Df, [[-6.0]])
    clock = lh.Hybrid(lambda t, x, a: -x, lh.Transition(every=0.5, reset=lambda t, x, a: a * t * x))
    found = lh.jacobians(clock, 2.0, [1.0], 3.0)
    assert_allclose(found.Dg[0], [[6.0]])
    assert_allclose(found.Dh[0], [0.0])
    assert_allclose(found.dh_dt[0], -1.0)
    only = lh.Hybrid(None, lh.Transition(every=1.0, reset=lambda t, x, a: a * x))
    found = lh.jacobians(only, 0.0, [1.0], 3.0)
    assert found.Df is None
    assert_allclose(found.Dg[0], [[3.0]])
    assert_allclose(lh.saltation_matrix(only, 0.0, [1.0], 3.0), [[3.0]])


# --- transformations ------------------------------------------------------------------------------


def test_jit_and_vmap():
    case, t, x, _ = random_case(np.random.default_rng(4), 3)
    args, x = jax.tree.map(jnp.asarray, case), jnp.asarray(x)
    eager = lh.saltation_matrix(FALLING, t, x, args)
    jitted = jax.jit(lambda x, args: lh.saltation_matrix(FALLING, t, x, args))
    assert_allclose(jitted(x, args), eager, rtol=1e-13)
    assert_allclose(jax.vmap(jitted, (0, None))(jnp.stack([x, x]), args)[1], eager, rtol=1e-13)
    assert_allclose(jax.jit(lambda x: lh.jacobians(FALLING, t, x, args, mode=0).Dg[0])(x), case["R"][0], rtol=1e-13)


def test_under_jit_a_tangential_contact_is_nan():
    ball = lh.Hybrid(
        lambda t, x, a: jnp.stack([x[1], -1.0 + 0 * x[0]]),
        lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], -x[1]])),
    )
    assert np.isnan(jax.jit(lambda x: lh.saltation_matrix(ball, 0.0, x))(jnp.zeros(2))).any()


# --- bad arguments --------------------------------------------------------------------------------

X = np.array([0.0, -1.0])
SIMPLE = lh.Hybrid(
    {"air": lambda t, x, a: jnp.stack([x[1], -1.0 + 0 * x[0]]), "rest": lambda t, x, a: 0 * x},
    [
        lh.Transition(lambda t, x, a: x[0], lambda t, x, a: -x, source="air"),
        lh.Transition(lambda t, x, a: x, lambda t, x, a, which: x),
    ],
)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"x": [0.1, -1.0]}, "not on the guard: its value is 0.1"),
        ({"x": [0.0, 0.0]}, "contact is tangential"),
        ({"transition": 2}, "transition must be an index from 0 to 1"),
        ({"transition": -1}, "transition must be an index from 0 to 1"),
        ({"transition": "bounce"}, "transition must be an index from 0 to 1"),
        ({"transition": ()}, "at least one transition"),
        (
            {"transition": 1, "mode": "air"},
            "transition 1 has 2 components: say which one fires, which=0 to 1",
        ),
        (
            {"transition": 1, "mode": "air", "which": 2},
            "components of transition 1's guard are 0 to 1; got which=2",
        ),
        ({"transition": (0, 1), "mode": "air", "which": (0,)}, "one entry for each"),
        ({"which": 1}, "components of transition 0's guard are 0 to 0"),
        ({"transition": 1, "which": 0}, "say which one it starts in"),
        ({"mode": "rest"}, r"Transition 0 leaves the modes \['air'\], not 'rest'"),
        ({"mode": "water"}, "Unknown mode 'water'"),
        ({"mode": 2}, "mode 2 is out of range"),
        ({"x": np.zeros((2, 2))}, r"x must have shape \(n,\) here; got \(2, 2\)"),
    ],
)
def test_bad_arguments_of_saltation_matrix(keywords, message):
    keywords = {"x": X} | keywords
    with pytest.raises(ValueError, match=message):
        lh.saltation_matrix(SIMPLE, 0.0, keywords.pop("x"), **keywords)


def test_systems_that_do_not_fit():
    with pytest.raises(ValueError, match="saltation_matrix needs a system that jumps.*got Flow"):
        lh.saltation_matrix(lh.Flow(lambda t, x, a: x), 0.0, [1.0])
    with pytest.raises(ValueError, match="EventDriven needs which"):
        lh.saltation_matrix(BALL, 1.2, [0.12, -1.1], 2.0)
    with pytest.raises(ValueError, match="say which one it starts in"):
        lh.jacobians(SIMPLE, 0.0, X)
    with pytest.raises(ValueError, match=r"x must have shape \(n,\)"):
        lh.jacobians(SIMPLE, 0.0, np.zeros((2, 2)), mode="air")
