"""Conditional and transverse exponents, and the master stability function: closed forms, and whole networks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import lyaphybrid as lh
from lyaphybrid import STATUS

STEP, LORENZ = lh.RungeKutta("rk4", dt=0.01), lh.zoo.lorenz63()
RING = np.roll(np.eye(4), 1, axis=0) + np.roll(np.eye(4), -1, axis=0) - 2 * np.eye(4)
CYCLE = np.roll(np.eye(3), 1, axis=1) - np.eye(3)  # each node hears the next: complex eigenvalues


def logistic(n, x, r):
    return r * x * (1 - x)


def oscillate(t, x, args):
    return jnp.stack([x[1], args["force"] * jnp.cos(args["omega"] * t) - x[0] - 0.1 * x[1]])


def wall(t, x, args):
    return args["gap"] - x[0]


def rebound(t, x, args):
    return jnp.stack([x[0], -0.8 * x[1]])


IMPACTING = lh.Hybrid(oscillate, lh.Transition(wall, rebound), names=("x", "v"))
IMPACTS = {"force": 1.0, "omega": 2.8, "gap": 0.0}
FASTER = IMPACTS | {"omega": 4.0}


def spring(t, x, args):
    return jnp.stack([0 * x[0], x[0]])


def spike(t, x, args):
    """A leaky neuron with an adaptation current and a filtered copy of it, x = (v, w, u)."""
    return jnp.stack([args - x[0] - x[1], -0.3 * x[1], 0.5 * (x[1] - x[2])])


NEURON = lh.Hybrid(
    spike, lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: jnp.stack([0 * x[0], x[1] + 0.3, x[2]]))
)


def filtered(t, x, args):
    return jnp.stack([x[2], 0 * x[1], 0 * x[2]])


def held(t, x, args):
    """x' = x + u with u held between the ticks of a clock; the input is seen at the ticks alone."""
    return jnp.stack([0.2 * x[0] + x[1], 0 * x[1]])


SAMPLED = lh.Hybrid(held, lh.Transition(every=0.5, reset=lambda t, x, args: jnp.stack([x[0], args["u"] - x[0]])))


def heard(args, c):
    return args | {"u": args["u"] + c[0]}


def of_network(node, coupling, matrix, x0, args, strength, vectors, *, enters=None, **how):
    """Growth rates of a whole network along a mode: (n N, parts n) columns e ⊗ v, one block of the frame a vector."""
    network = lh.coupled_network(node, coupling, matrix, enters=enters)
    n = len(x0)
    frame = np.concatenate([np.kron(v[:, None], np.eye(n)) for v in vectors], axis=1)
    run = lh.lyapunov_spectrum(network, np.tile(x0, len(matrix)), (args, strength), frame=frame, transient=0.0, **how)
    return np.sort(np.asarray(run.exponents))[::-1]


# --- closed forms ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [-0.3, 0.5, -1.7])
def test_maps_coupled_through_themselves_gain_ln_of_one_plus_alpha(alpha):
    alone = lh.lyapunov_spectrum(lh.Map(logistic), [0.3], 3.9, t1=500, blocks=4)
    found = lh.master_stability(lh.Map(logistic), logistic, [0.3], 3.9, at=alpha, t1=500, blocks=4)
    assert_allclose(found.exponents[0], alone.exponents + np.log(abs(1 + alpha)), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    "alpha", [-0.7, pytest.param(0.4 + 0.9j, marks=pytest.mark.slow), pytest.param(-1.5 - 0.2j, marks=pytest.mark.slow)]
)
def test_a_linear_flow_has_the_eigenvalues_of_its_matrix_with_the_coupling(alpha):
    a, h = np.array([[0.1, -1.0], [1.2, -0.4]]), np.array([[0.5, 0.2], [0.0, 1.0]])
    node, couple = lh.Flow(lambda t, x, args: jnp.asarray(a) @ x), lambda t, x, args: jnp.asarray(h) @ x
    found = lh.master_stability(node, couple, [0.0, 0.0], at=alpha, k=2, t1=800.0, transient=400.0)
    exact = np.sort(np.linalg.eigvals(a + alpha * h).real)[::-1]
    assert_allclose(found.exponents[0], exact, rtol=0, atol=2e-3)
    assert_allclose(np.sum(found.exponents[0]), np.sum(exact), rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_coupling_through_the_resets_of_clocks_has_the_eigenvalues_of_the_cycle():
    alpha, grown = -0.4, np.exp(0.1)
    cycle = np.array([[grown, (grown - 1) / 0.2], [0.0, 1.0]]) @ np.array([[1.0, 0.0], [alpha - 1.0, 0.0]])
    largest = np.log(np.max(np.abs(np.linalg.eigvals(cycle)))) / 0.5
    per_cycle = lh.master_stability(
        SAMPLED, lambda t, x, args: x[:1], [0.0, 0.0], {"u": 0.0}, at=alpha, enters=heard, t1=200.0, transient=100.25
    )
    assert_allclose(per_cycle.largest[0], largest, rtol=0, atol=1e-9)


def beside(t, x, args):
    """x' = a x of three parts, the first of which is driven by the others and acts on nothing; x = 0 is the motion."""
    return jnp.stack([-2.0 * x[0] + x[1] + x[2], 0.5 * x[1] + x[2], -x[1] + 0.3 * x[2]])


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [-0.1, 0.1 + 0.4j])
def test_one_exponent_is_the_largest_wherever_the_part_that_grows_stands(alpha):
    a = np.asarray(jax.jacfwd(lambda x: beside(0.0, x, None))(np.zeros(3)))
    node, couple = lh.Flow(beside), lambda t, x, args: x
    found = lh.master_stability(node, couple, np.zeros(3), at=alpha, t1=400.0, transient=100.0)
    exact = np.linalg.eigvals(a + alpha * np.eye(3)).real
    assert_allclose(found.largest[0], exact.max(), rtol=0, atol=3e-3)
    pair = lh.transverse_spectrum(node, np.zeros(3), response=[0, 1], k=1, t1=400.0, transient=100.0)
    assert_allclose(pair.exponents, [0.5], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_linear_response_has_its_own_eigenvalues():
    a = np.array([[0.0, 1.0, 0.5], [-1.0, 0.0, 0.0], [0.3, 0.4, -0.6]])
    found = lh.transverse_spectrum(lh.Flow(lambda t, x, a: a @ x), [1.0, 0, 0], jnp.asarray(a), response=[2], t1=20.0)
    assert_allclose(found.exponents, [-0.6], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_lorenz_driven_by_x_or_by_y():
    """x drives: δy' = −δy − x δz, δz' = −b δz + x δy has the mean divergence −1 − b. y drives: exactly −σ and −b."""
    how = {"x0": LORENZ.x0, "args": LORENZ.args, "t1": 50.0, "transient": 10.0}
    by_x = lh.transverse_spectrum(LORENZ.system, response=[1, 2], **how)
    by_y = lh.transverse_spectrum(LORENZ.system, response=[0, 2], **how)
    assert_allclose(np.sum(by_x.exponents), -1 - 8 / 3, rtol=0, atol=1e-7)
    assert_allclose(by_y.exponents, [-8 / 3, -10.0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_driven_impact_oscillator_has_the_exponents_of_the_driven_part():
    """The drive, a harmonic oscillator, does not feel the impacts: the response is a forced oscillator."""

    def both(t, x, args):
        q, p, *own = x
        return jnp.stack([2.8 * p, -2.8 * q, own[1], q - own[0] - 0.1 * own[1]])

    system = lh.Hybrid(
        both,
        lh.Transition(lambda t, x, args: -x[2], lambda t, x, args: jnp.stack([x[0], x[1], x[2], -0.8 * x[3]])),
        names=("q", "p", "x", "v"),
    )
    how = {"t1": 30.0, "method": lh.RungeKutta(rtol=1e-12, atol=1e-13)}
    found = lh.transverse_spectrum(system, [1.0, 0.0, -1.0, 0.0], response=["x", "v"], **how)
    forced = lh.lyapunov_spectrum(IMPACTING, [-1.0, 0.0], IMPACTS, **how)
    assert_allclose(found.exponents, forced.exponents, rtol=0, atol=1e-7)


# --- whole networks ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("node", "coupling", "x0", "args", "more"),
    [
        (lh.Map(logistic), logistic, [0.3], 3.9, {"t1": 200}),
        (LORENZ.system, lambda t, x, args: x, [1.0, 2.0, 20.0], LORENZ.args, {"t1": 3.0}),
        (IMPACTING, spring, [-1.0, 0.3], IMPACTS, {"t1": 12.0}),
        (NEURON, filtered, [0.2, 0.1, 0.05], 1.6, {"t1": 8.0}),
        (SAMPLED, lambda t, x, args: x[:1], [1.0, 0.0], {"u": 0.0}, {"t1": 6.3, "enters": heard}),
    ],
    ids=["map", "flow", "impacts", "neurons", "clocks"],
)
@pytest.mark.slow_cases(
    *(f"matrix{i}-vector{i}-{g}-{one}" for i, g in ((0, -4.0), (1, -2.0)) for one in ("impacts", "neurons"))
)
@pytest.mark.parametrize(("matrix", "vector", "gamma"), [(RING, [1.0, -1, 1, -1], -4.0), (RING, [1.0, 0, -1, 0], -2.0)])
def test_a_mode_is_a_block_of_the_network(node, coupling, x0, args, more, matrix, vector, gamma):
    how = {"blocks": 4, "every": 1, **more}
    how |= {} if isinstance(node, lh.Map) else {"method": STEP}
    whole = of_network(node, coupling, matrix, x0, args, 0.15, [np.array(vector)], **how)
    block = lh.master_stability(node, coupling, x0, args, at=0.15 * gamma, k=len(x0), **how)
    assert_allclose(block.exponents[0], whole, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_complex_mode_is_a_block_of_a_directed_ring():
    values, vectors = np.linalg.eig(CYCLE)
    one = np.flatnonzero(values.imag > 0.1)[0]
    parts = [vectors[:, one].real, vectors[:, one].imag]
    how = {"t1": 12.0, "blocks": 4, "every": 1, "method": STEP}
    whole = of_network(IMPACTING, spring, CYCLE, [-1.0, 0.3], IMPACTS, 0.3, parts, **how)
    block = lh.master_stability(IMPACTING, spring, [-1.0, 0.3], IMPACTS, at=0.3 * values[one], k=2, **how)
    assert_allclose(np.sum(block.exponents[0]), np.sum(whole) / 2, rtol=0, atol=1e-9)


CRITICAL = {
    "map": (lh.Map(logistic), logistic, [0.3], 3.9, {"t1": 200}, (0.05, 0.12)),
    "impacts": (IMPACTING, spring, [-1.0, 0.3], FASTER, {"t1": 20.0, "method": STEP}, (-0.1, 0.9)),
    "neurons": (NEURON, filtered, [0.2, 0.1, 0.05], 1.6, {"t1": 8.0, "method": STEP}, (-1.3, -0.9)),
}


@pytest.mark.slow_cases("impacts", "neurons")
@pytest.mark.parametrize("name", CRITICAL)
def test_the_critical_strength_is_that_of_the_whole_network(name):
    """Where the largest exponent of finite runs across the common motion of a ring of four is zero."""
    node, coupling, x0, args, how, bracket = CRITICAL[name]
    how = {"blocks": 4, "every": 1, **how}

    def blocks(strengths):
        found = lh.master_stability(node, coupling, x0, args, at=-4.0 * strengths, k=len(x0), **how)
        return np.max(np.asarray(found.exponents), axis=1)

    def block(strength):
        return float(blocks(np.array([strength]))[0])

    def whole(strength):
        return of_network(node, coupling, RING, x0, args, strength, [np.array([1.0, -1, 1, -1])], **how)[0]

    strengths = np.linspace(*bracket, 21)
    curve = blocks(strengths)
    at = np.flatnonzero(np.sign(curve[:-1]) != np.sign(curve[1:]))[0]
    low, high = strengths[at : at + 2]
    assert abs(brentq(block, low, high, xtol=1e-9) - brentq(whole, low, high, xtol=1e-9)) < 1e-6


@pytest.mark.slow
def test_the_quotient_of_a_pair_is_its_mode():
    pair = lh.coupled_network(lh.zoo.rossler().system, lambda t, x, args: x, [[-1.0, 1.0], [1.0, -1.0]])
    start, args = [1.0, 2.0, 0.5], (lh.zoo.rossler().args, 0.1)
    common = np.vstack([np.eye(3), np.eye(3)])
    how = {"t1": 20.0, "blocks": 4, "every": 1, "method": STEP}
    across = lh.transverse_spectrum(pair, [*start, *start], args, subspace=common, **how)
    block = lh.master_stability(
        lh.zoo.rossler().system, lambda t, x, args: x, start, lh.zoo.rossler().args, at=-0.2, k=3, **how
    )
    assert_allclose(across.exponents, block.exponents[0], rtol=0, atol=1e-9)
    assert_allclose(across.x[:3], across.x[3:6], rtol=0, atol=1e-12)  # the motion is kept there, stable or not


def side(sign):
    def field(t, x, args):
        return jnp.stack([x[1], args["u"] + jnp.sin(t) - 0.6 * sign - x[0]])

    return field


RELAY = lh.filippov(side(1.0), side(-1.0), lambda t, x, args: x[1])


def one_pushes(args, c):
    return args | {"u": args["u"] + c[0]}


def both_sides(signs):
    """The field of two relays in given modes, +, − or 0 (sliding), coupled through their positions, α = −2 strength."""

    def field(t, x, args):
        (x1, v1), (x2, v2) = x[:2], x[2:]
        inputs = args * (x2 - x1), args * (x1 - x2)
        forces = [u + jnp.sin(t) - q for u, q in zip(inputs, (x1, x2), strict=True)]
        rates = [
            0.0 * v if sign == 0 else force - 0.6 * sign for sign, force, v in zip(signs, forces, (v1, v2), strict=True)
        ]
        moved = [0.0 * v if sign == 0 else v for sign, v in zip(signs, (v1, v2), strict=True)]
        return jnp.stack([moved[0], rates[0], moved[1], rates[1]])

    return field


PAIR = np.array([[-1.0, 1.0], [1.0, -1.0]])
TWO_RELAYS = lh.coupled_network(RELAY, lambda t, x, args: x[:1], PAIR, enters=one_pushes)


@pytest.mark.slow
def test_a_network_of_relays_has_the_exponents_of_its_modes():
    """Both reach the surface, slide and leave it at one instant, one after the other."""
    start, how = np.array([0.8, 0.5]), {"t1": 9.0, "blocks": 2, "method": lh.RungeKutta(rtol=1e-12, atol=1e-13)}
    assert TWO_RELAYS.mode_names[:4] == ("plus,plus", "plus,minus", "plus,sliding", "minus,plus")
    apart = np.kron([[1.0], [-1.0]], np.eye(2))[:, :1]
    args = ({"u": 0.0}, 0.25)
    whole = lh.lyapunov_spectrum(TWO_RELAYS, [*start, *start], args, frame=apart, transient=0.0, **how)
    found = lh.master_stability(
        RELAY, lambda t, x, args: x[:1], start, {"u": 0.0}, at=-0.5, enters=one_pushes, mode="plus", k=2, **how
    )  # fmt: skip
    assert_allclose(whole.exponents[0], found.exponents[0, 0], rtol=0, atol=1e-9)
    assert_allclose(whole.x[:2], whole.x[2:], rtol=0, atol=1e-12)


def toggling(clock, **more):
    def field(level):
        return lambda t, x, args: jnp.stack([level + 0.3 * x[1] - x[0], args["u"] - x[1]])

    return lh.Hybrid({"a": field(1.0), "b": field(-1.0)}, lh.Transition(every=0.5, **clock), **more)


@pytest.mark.slow
def test_clocks_change_the_modes_of_nodes():
    """Two nodes that begin in different modes: a tick moves those in "a", and a guard brings them back one by one."""
    fields = dict(zip("ab", toggling({}).fields, strict=True))
    node = lh.Hybrid(
        fields,
        [
            lh.Transition(every=0.5, source="a", target="b"),
            lh.Transition(lambda t, x, args: x[0] + 0.2, source="b", target=lambda t, x, args: jnp.asarray(0)),
        ],
    )
    pair = lh.coupled_network(node, lambda t, x, args: x[1:], PAIR, enters=one_pushes)
    found = lh.trajectory(pair, [0.3, 1.0, -0.1, 0.4], ({"u": 0.2}, 0.7), t1=6.0, mode="a,b", n=2)
    t, x, modes, ends = 0.0, np.array([0.3, 1.0, -0.1, 0.4]), [0, 1], []

    def field(t, x):
        u = 0.2 + 0.7 * np.array([x[3] - x[1], x[1] - x[3]])
        return [
            rate for i in (0, 1) for rate in (1 - 2 * modes[i] + 0.3 * x[2 * i + 1] - x[2 * i], u[i] - x[2 * i + 1])
        ]

    def falls(i):
        def guard(t, x):
            return x[2 * i] + 0.2 if modes[i] else 1.0

        guard.terminal, guard.direction = True, -1
        return guard

    while t < 6.0:
        tick = 0.5 * np.floor(t / 0.5 + 1 + 1e-12)
        part = solve_ivp(field, (t, tick), x, events=[falls(0), falls(1)], rtol=1e-12, atol=1e-13)
        t, x = part.t[-1], part.y[:, -1]
        modes = [0 if len(part.t_events[i]) else 1 if t == tick else modes[i] for i in (0, 1)]
        ends.append((t, 2 * modes[0] + modes[1]))
    changes = [ends[0], *(b for a, b in zip(ends, ends[1:], strict=False) if a[1] != b[1])]
    seen = np.asarray(found.events.mode_after), np.asarray(found.events.t)
    assert len(changes) > 6
    kept = np.flatnonzero(np.diff(seen[0], prepend=-1))
    assert_allclose(seen[1][kept], [t for t, _ in changes], rtol=0, atol=1e-7)
    assert list(seen[0][kept]) == [q for _, q in changes]
    assert_allclose(found.x[-1], x, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_nodes_with_a_vector_guard_and_a_condition_for_each_component():
    """A ball between two walls, one of which can be switched off; two of them joined by a spring."""
    between = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -0.1 * x[0]]),
        lh.Transition(
            lambda t, x, args: jnp.stack([1.0 - x[0], 1.0 + x[0]]),
            lambda t, x, args, which: jnp.stack([x[0], jnp.where(which == 0, -0.9, -0.8) * x[1]]),
            when=lambda t, x, args: jnp.stack([x[1] > 0, x[1] < 0]),
        ),
        names=["x", "v"],
    )
    pair = lh.coupled_network(between, lambda t, x, args: jnp.stack([0 * x[0], x[0]]), PAIR)
    assert pair.names == ("x1", "v1", "x2", "v2")
    found = lh.trajectory(pair, [0.0, 1.0, 0.2, -0.7], (None, 0.3), t1=20.0, n=2)
    t, x = 0.0, np.array([0.0, 1.0, 0.2, -0.7])
    stiffness = np.array([[0.0, 1, 0, 0], [-0.4, 0, 0.3, 0], [0, 0, 0, 1], [0.3, 0, -0.4, 0]])
    walls = []
    for i, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        walls.append(lambda t, x, i=i, sign=sign: 1.0 - sign * x[2 * i])
        walls[-1].terminal, walls[-1].direction = True, -1
    count = 0
    while t < 20.0:
        part = solve_ivp(lambda t, x: stiffness @ x, (t, 20.0), x, events=walls, rtol=1e-12, atol=1e-13)
        t, x = part.t[-1], part.y[:, -1].copy()
        for j in range(4):
            if len(part.t_events[j]):
                x[2 * (j // 2) + 1] *= (-0.9, -0.8)[j % 2]
                count += 1
    assert len(found.events) == count > 4
    assert_allclose(found.x[-1], x, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_many_nodes_may_jump_at_one_instant():
    """Twenty equal neurons fire together: no cascade of one."""
    ring = np.roll(np.eye(20), 1, axis=0) - np.eye(20)
    many = lh.coupled_network(NEURON, filtered, ring)
    run = lh.trajectory(many, np.tile([0.2, 0.1, 0.1], 20), (1.6, 0.1), t1=4.0, n=2)
    assert run.status is STATUS.ok
    assert len(run.events) % 20 == 0
    assert len(run.events) >= 40


@pytest.mark.slow
def test_two_coupled_relays_that_slide_move_apart_as_the_mode_says():
    """Two Filippov systems, each in one of three modes, pushed a little apart: a difference of whole motions."""
    alpha, end, push = -0.5, 9.0, 1e-6
    start, tight = np.array([0.8, 0.5]), {"rtol": 1e-12, "atol": 1e-13}

    def moved(first, second):
        signs = {"+": 1, "-": -1, "0": 0}
        names = [a + b for a in signs for b in signs]
        fields = {name: both_sides([signs[one] for one in name]) for name in names}
        transitions = []
        for own, v in ((0, 1), (1, 3)):
            for name in names:
                force = _force(own)
                other = lambda now, own=own, name=name: name[:own] + now + name[own + 1 :]  # noqa: E731
                if name[own] == "0":  # leaves the surface where the force exceeds that of friction
                    up = lambda t, x, args, force=force: 0.6 - force(t, x, args)  # noqa: E731
                    down = lambda t, x, args, force=force: 0.6 + force(t, x, args)  # noqa: E731
                    transitions += [lh.Transition(up, source=name, target=other("+"))]
                    transitions += [lh.Transition(down, source=name, target=other("-"))]
                    continue
                sign = signs[name[own]]
                slides = lambda t, x, args, force=force: jnp.abs(force(t, x, args)) < 0.6  # noqa: E731
                crosses = lambda t, x, args, force=force: jnp.abs(force(t, x, args)) >= 0.6  # noqa: E731
                guard = lambda t, x, args, v=v, sign=sign: sign * x[v]  # noqa: E731
                stop = lambda t, x, args, v=v: x.at[v].set(0.0)  # noqa: E731
                transitions += [lh.Transition(guard, stop, source=name, target=other("0"), when=slides)]
                opposite = other("-" if sign > 0 else "+")
                transitions += [lh.Transition(guard, source=name, target=opposite, when=crosses)]
        pair = lh.Hybrid(fields, transitions)
        run = lh.trajectory(pair, [*first, *second], -alpha / 2, t1=end, mode="++", n=2, method=lh.RungeKutta(**tight))
        assert len(run.events) > 4
        same = lh.trajectory(
            TWO_RELAYS, [*first, *second], ({"u": 0.0}, -alpha / 2), t1=end, n=2, method=lh.RungeKutta(**tight)
        )
        assert_allclose(same.events.t, run.events.t, rtol=0, atol=1e-10)
        assert_allclose(same.x[-1], run.x[-1], rtol=0, atol=1e-10)
        return np.asarray(run.x[-1])

    def _force(own):
        def force(t, x, args):
            q, other = x[2 * own], x[2 - 2 * own]
            return args * (other - q) + jnp.sin(t) - q

        return force

    node = lh.trajectory(RELAY, start, {"u": 0.0}, t1=end, mode="plus", n=2, method=lh.RungeKutta(**tight))
    assert "sliding" in [RELAY.mode_names[i] for i in np.asarray(node.events.mode_after)]
    ahead, behind = (moved(start + sign * push * np.eye(2)[0], start - sign * push * np.eye(2)[0]) for sign in (1, -1))
    apart = ((ahead - behind)[:2] - (ahead - behind)[2:]) / (4 * push)  # of ξ along (1, −1), started as (1, 0)
    found = lh.master_stability(
        RELAY,
        lambda t, x, args: x[:1],
        start,
        {"u": 0.0},
        at=alpha,
        enters=one_pushes,
        t1=end,
        mode="plus",
        k=2,  # all begin with unit vectors
        blocks=2,
        method=lh.RungeKutta(**tight),
    )
    assert_allclose(np.exp(end * found.largest[0]), np.linalg.norm(apart), rtol=1e-5)


# --- derivatives, sweeps -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_derivative_by_a_parameter_is_that_of_differences():
    def largest(force):
        args = IMPACTS | {"force": force}
        found = lh.master_stability(IMPACTING, spring, [-1.0, 0.3], args, at=[-0.3], t1=4.0, method=STEP, blocks=4)
        return found.exponents[0, 0]

    slope = jax.jacfwd(largest)(jnp.asarray(1.0))
    h = 1e-5
    assert_allclose(slope, (largest(1.0 + h) - largest(1.0 - h)) / (2 * h), rtol=1e-5)


@pytest.mark.slow
def test_the_strength_has_a_derivative():
    def largest(alpha):
        return lh.master_stability(lh.Map(logistic), logistic, [0.3], 3.9, at=alpha, t1=50, blocks=4).exponents[0, 0]

    assert_allclose(jax.grad(largest)(jnp.asarray(-0.3)), 1 / 0.7, rtol=1e-9)


@pytest.mark.slow
def test_conditional_exponents_are_swept():
    def run(args):
        how = {"response": [0, 2], "t1": 5.0, "transient": 5.0}
        return lh.transverse_spectrum(LORENZ.system, [1.0, 2.0, 20.0], args, **how)

    over = {"beta": [1.0, 2.0]}
    found = lh.sweep(run, over, args=LORENZ.args, progress=False)
    assert_allclose(found.exponents[:, 0], [-1.0, -2.0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_conditional_exponents_have_derivatives_and_go_on():
    """Driven by y, Lorenz' z contracts at the rate β whatever the motion."""

    def conditional(beta, t1, blocks=4):
        how = {"response": [0, 2], "t1": t1, "transient": 4.0, "blocks": blocks}
        return lh.transverse_spectrum(LORENZ.system, [1.0, 2.0, 20.0], LORENZ.args | {"beta": beta}, **how)

    assert_allclose(jax.jacfwd(lambda beta: conditional(beta, 2.0).exponents[0])(jnp.asarray(1.5)), -1, rtol=1e-6)
    one, longer = conditional(1.5, 8.0, 8), conditional(1.5, 4.0).resume(8.0)
    assert_allclose(longer.exponents, one.exponents, rtol=1e-8)


@pytest.mark.slow
def test_strengths_are_swept_into_a_store(tmp_path):
    """A long master stability function: each strength is a point, kept as soon as it is done."""

    def run(args):
        found = lh.master_stability(lh.Map(logistic), logistic, [0.3], args["r"], at=args["alpha"], t1=200, throw=False)
        return {"largest": found.largest[0], "status_code": found.status_code[0]}

    over, args = {"alpha": np.linspace(-1.5, -0.5, 6)}, {"r": 3.9, "alpha": -1.0}
    how = {"args": args, "chunk": 2, "progress": False, "store": tmp_path / "strengths.zarr"}
    found, again = lh.sweep(run, over, **how), lh.sweep(run, over, **how)
    exact = lh.master_stability(lh.Map(logistic), logistic, [0.3], 3.9, at=over["alpha"], t1=200)
    assert_allclose(found.largest, exact.largest, rtol=1e-9)
    assert np.array_equal(found.largest, again.largest)


@pytest.mark.slow
def test_critical_strengths_are_where_the_largest_exponent_changes_its_sign():
    found = lh.master_stability(lh.Map(logistic), logistic, [0.3], 4.0, at=np.linspace(-1.9, -0.1, 37), t1=4000)
    assert_allclose(found.critical, [-1.5, -0.5], atol=0.02)  # ln 2 + ln|1 + α| = 0
    assert "stable at" in str(found)
    assert found.to_xarray().exponents.dims == ("at", "exponent")


# --- bad input, trouble ------------------------------------------------------------------------------------------


def of_impacts(coupling, at=0.1, t1=9.0, **more):
    return lh.master_stability(IMPACTING, coupling, [-1.0, 0.3], IMPACTS, at=at, t1=t1, **more)


@pytest.mark.slow_cases(
    "<lambda>-output jumps1", "<lambda>-output jumps0", "<lambda>-a guard or its reset depends on the input"
)
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: of_impacts(lambda t, x, a: x, t1=200.0), "output jumps"),
        (  # no impact before t = 12
            lambda: lh.master_stability(
                lh.Hybrid(lambda t, x, a: jnp.stack([x[1], 0 * t - 1]), lh.Transition(lambda t, x, a: x[0], rebound)),
                lambda t, x, a: x, [50.0, 5.0], at=0.1, t1=100.0,
            ),
            "output jumps",
        ),
        (lambda: of_impacts(lambda t, x, a: x[0]), "shape"),
        (lambda: of_impacts(spring, at=np.nan), "finite"),
        (lambda: of_impacts(spring, k=3), "at most n = 2"),
        (lambda: lh.master_stability(lambda t, x, a: x, spring, [1.0], at=1.0, t1=9.0), "takes an lh.Flow"),
        (
            lambda: lh.master_stability(
                lh.Hybrid(oscillate, lh.Transition(lambda t, x, a: a["gap"] - x[0], rebound)),
                lambda t, x, a: x[:1], [-1.0, 0.3], IMPACTS, at=0.1, t1=200.0,
                enters=lambda args, c: args | {"gap": c[0]},
            ),
            "a guard or its reset depends on the input",
        ),
        (lambda: lh.master_stability(RELAY, spring, [0.8, 0.5], {"u": 0.0}, at=0.1, t1=9.0), "bound to a surface"),
        (lambda: lh.transverse_spectrum(IMPACTING, [-1.0, 0.3], IMPACTS, t1=9.0), "Give one of response"),
        (lambda: lh.transverse_spectrum(IMPACTING, [-1.0, 0.3], IMPACTS, response=["y"], t1=9.0), "of 0 … 1"),
        (lambda: lh.transverse_spectrum(IMPACTING, [-1.0, 0.3], IMPACTS, response=[0, 1], t1=9.0), "leave a drive"),
        (lambda: lh.transverse_spectrum(IMPACTING, [-1.0, 0.3], IMPACTS, response="xv", t1=9.0), "a list"),
        (lambda: lh.transverse_spectrum(IMPACTING, [-1.0, 0.3], IMPACTS, response=["x"], t1=200.0), "moves the drive"),
        (
            lambda: lh.transverse_spectrum(LORENZ.system, [1.0, 1, 1], LORENZ.args, subspace=[[1.0], [1], [0]], t1=9.0),
            "must lie in the subspace",
        ),
        (
            lambda: lh.transverse_spectrum(LORENZ.system, [1.0, 1, 0], LORENZ.args, subspace=[[1.0], [1], [0]], t1=9.0),
            "does not stay in the subspace: the field",
        ),
        (lambda: lh.coupled_network(IMPACTING, spring, [[1.0, 1.0], [1.0, 1.0]]), "must sum to 0"),
        (lambda: lh.coupled_network(RELAY, spring, CYCLE), "the modes .'sliding'. a node is bound to a surface"),
        (lambda: lh.coupled_network(RELAY, spring, RING, enters=one_pushes), "4 nodes with 3 modes have 81"),
        (lambda: lh.coupled_network(toggling({"target": "b"}), spring, CYCLE), "clocks that change no mode"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.slow
def test_a_motion_that_ends_says_so():
    ball = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -0.5 * x[1]])),
    )
    found = lh.master_stability(ball, spring, [1.0, 0.0], at=[-0.1, 0.1], t1=100.0, throw=False)
    assert found.status == STATUS.zeno
    assert np.all(found.status_code == STATUS.zeno)
    with pytest.raises(lh.RunFailedError, match="2 zeno"):
        lh.master_stability(ball, spring, [1.0, 0.0], at=[-0.1, 0.1], t1=100.0)


def test_in_a_sweep_what_leaves_the_subspace_is_nan():
    """Two copies with coupling from both sides stay together, with another parameter in one of them they do not."""

    def pair(t, x, args):
        flow = LORENZ.system.field
        first, second = flow(t, x[:3], LORENZ.args), flow(t, x[3:], LORENZ.args)
        drift = args["apart"] * jnp.array([0.0, 1.0, 0.0])
        return jnp.concatenate([first + args["c"] * (x[3:] - x[:3]), second + args["c"] * (x[:3] - x[3:]) + drift])

    def across(args):
        how = {"subspace": np.vstack([np.eye(3), np.eye(3)]), "t1": 4.0, "blocks": 4}
        return lh.transverse_spectrum(lh.Flow(pair), [1.0, 1.0, 20.0] * 2, args, **how)

    args = {"c": 4.0, "apart": 0.0}
    found = lh.sweep(across, {"apart": [0.0, 0.1]}, args=args, progress=False)
    assert_allclose(found.exponents[0], across(args).exponents, rtol=1e-9)
    assert np.all(np.isnan(found.exponents[1]))
    assert np.all(np.isnan(found.stderr[1]))
