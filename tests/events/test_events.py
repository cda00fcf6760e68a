"""Where and when events happen: the rules, each on the smallest system that shows it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import STATUS

METHODS = [lh.RungeKutta(), lh.RungeKutta("rk4", dt=0.05)]


def ones(t, x, args):
    """Time as a state: x' = 1."""
    return jnp.ones_like(x)


def counter(t, x, args, which=0):
    """Stay, and count: the second component is a number of events."""
    return x.at[1].add(1.0)


def clockwork(t, x, args):
    """x[0] is the time, x[1] a counter."""
    return jnp.stack([jnp.ones_like(x[0]), jnp.zeros_like(x[1])])


def times(system, x0, args=None, *, t1, **options):
    return np.asarray(lh.trajectory(system, x0, args, t1=t1, n=2, **options).events.t)


FALLING = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -jnp.ones_like(x[0])]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([0 * x[0], -args * x[1]])),
)


# --- how precisely ---------------------------------------------------------------------------------------------


@pytest.mark.slow_cases("1000000.0")
@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_event_times_to_the_last_digits_at_any_time(t0):
    """Sine against a level, 40 roots; the local scale of time is 1, the resolution of t = 1e6 is 1.2e-10."""
    wave = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -x[0], 0 * x[2]]),
        lh.Transition(lambda t, x, args: x[0] - 0.3, lambda t, x, args: x.at[2].add(1.0), direction=0),
    )
    log = lh.trajectory(wave, [0.0, 1.0, 0.0], t0=t0, t1=130.0, n=2, method=lh.RungeKutta(rtol=1e-13)).events
    first = np.arcsin(0.3)
    exact = np.sort(np.concatenate([first + 2 * np.pi * np.arange(21), np.pi - first + 2 * np.pi * np.arange(21)]))
    exact = exact[exact < 130]
    assert len(log) == len(exact)
    rounding = 2e-10 if t0 else 0.0
    assert_allclose(np.asarray(log.t) - t0, exact, rtol=0, atol=2e-11 + rounding)  # 1e-13 a step, for 20 periods
    assert_allclose(np.asarray(log.x_before)[:, 0], 0.3, rtol=0, atol=1e-14)  # the root itself does not drift


@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_a_single_root_to_1e_12_of_the_local_scale_of_time(t0):
    """x = ln(1 + s), a root at s = 1; time is local, so that t = 1e6 costs the state no digit."""
    slow = lh.Hybrid(
        lambda t, x, args: jnp.exp(-x), lh.Transition(lambda t, x, args: np.log(2) - x[0], lambda t, x, args: 0 * x)
    )
    path = lh.trajectory(slow, [0.0], t0=t0, t1=7.5, n=1, method=lh.RungeKutta(rtol=1e-13, atol=1e-15))
    assert len(path.events) == 7
    assert_allclose(path.x[-1, 0], np.log(1.5), rtol=0, atol=1e-11)  # seven unit flights and a half, wherever t began
    if t0 == 0:
        assert_allclose(path.events.t, np.arange(1, 8), rtol=0, atol=1e-12)


# --- one soon after the other ------------------------------------------------------------------------------------

APART = [sign * d for d in (1e-8, 1e-10, 1e-12, 1e-13) for sign in (1, -1)]


@pytest.mark.slow
@pytest.mark.parametrize("t0", [0.0, 1e3])
@pytest.mark.parametrize("method", METHODS)
def test_two_balls_that_bounce_one_soon_after_the_other_keep_their_difference(method, t0):
    """Elastic bounces under x'' = −1: two balls on the same orbit, apart in time by δ, have v₁ − v₂ = δ for ever."""

    def turned(i):
        return lh.Transition(lambda t, x, args: x[i], lambda t, x, args: x.at[i + 1].multiply(-1.0))

    def falling(t, x, args):
        return jnp.stack([x[1], -jnp.ones_like(x[0]), x[3], -jnp.ones_like(x[0])])

    balls = lh.Hybrid(falling, [turned(0), turned(2)])
    for apart in APART:
        s = np.array([0.5, 0.5 + apart])  # since they left the floor
        start = np.stack([s - s**2 / 2, 1 - s], axis=1).ravel()
        run = lh.trajectory(balls, start, t0=t0, t1=20.0, n=1, method=method)
        assert len(run.events) == 20
        kept = float(run.x[-1, 1] - run.x[-1, 3]) - (start[1] - start[3])
        assert abs(kept) < 5e-14, apart  # rounding of 20 bounces; in the wrong order each turns the difference


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_distance_that_bends_sharply_between_two_events_does_not_fire(method):
    """x' = 3 where x < 0 and 1 beyond: two copies come out a third as far apart, not a tenth.

    While one is across and the other is not their distance bends so sharply that within a step it would be huge.
    """
    speeds = {"none": (3.0, 3.0), "first": (1.0, 3.0), "second": (3.0, 1.0), "both": (1.0, 1.0)}

    def field(of):
        return lambda t, x, args: jnp.asarray(of) + 0 * x

    def crosses(i, before, after):
        return lh.Transition(lambda t, x, args: x[i], source=before, target=after, direction=1)

    def closer(t, x, args):
        return (x[1] - x[0]) ** 2 / args**2 - 1

    ways = [(0, "none", "first"), (1, "none", "second"), (1, "first", "both"), (0, "second", "both")]
    transitions = [crosses(*way) for way in ways] + [lh.Transition(closer, direction=-1, terminal=True)]
    copies = lh.Hybrid({name: field(of) for name, of in speeds.items()}, transitions)
    for apart in (1e-6, -1e-8, 1e-10, -1e-11):
        start = np.array([-0.6, -0.6 + apart])
        run = lh.trajectory(copies, start, 0.1 * abs(apart), t1=2.0, n=1, method=method, mode="none")
        assert run.status == STATUS.ok
        assert len(run.events) == 2
        assert abs(float(run.x[-1, 1] - run.x[-1, 0]) - (start[1] - start[0]) / 3) < 5e-15, apart


@pytest.mark.slow
def test_a_guard_that_is_noisy_by_rounding_does_not_shorten_the_steps():
    """A copy comes nearer at a large angle, to 2e-13: rounding leaves one digit of the distance."""

    def field(t, x, args):
        return jnp.stack([jnp.ones_like(t), 1.0 - 0.2 * (x[1] - x[0])])

    guard = lh.Transition(lambda t, x, args: (x[1] - x[0]) ** 2 / 1e-30 - 1, direction=-1, terminal=True)
    run = lh.trajectory(lh.Hybrid(field, [guard]), [74.0, 74.0 + 1e-11], t1=20.0, n=1, max_steps=500)
    assert run.status == STATUS.ok


# --- which -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=["adaptive", "fixed"])
def test_the_earliest_of_several_in_one_step(method):
    """Five guards cross within 0.02 of time, in an order unlike their numbers."""
    levels = jnp.asarray([0.513, 0.507, 0.519, 0.501, 0.510])
    system = lh.Hybrid(
        lambda t, x, args: jnp.ones_like(x),
        lh.Transition(lambda t, x, args: args - x[0], lambda t, x, args, which: x, direction=0),
    )
    log = lh.trajectory(system, [0.0], levels, t1=1.0, n=2, method=method).events
    assert np.asarray(log.which).tolist() == [3, 1, 4, 0, 2]
    assert_allclose(log.t, np.sort(levels), rtol=0, atol=1e-13)


@pytest.mark.slow_cases(
    all_but=(
        "fixed-0.0001",
        "fixed-1e-06",
    )
)
@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("method", METHODS, ids=["adaptive", "fixed"])
def test_a_guard_that_dips_below_zero_and_comes_back_inside_a_step(depth, method):
    """h = (t - c)² - depth: one extremum between two roots, far nearer than a step."""
    system = lh.Hybrid(clockwork, lh.Transition(lambda t, x, args: (x[0] - 0.777) ** 2 - args, counter), max_cascade=4)
    found = times(system, [0.0, 0.0], depth, t1=2.0, method=method)
    assert_allclose(found, [0.777 - depth**0.5], rtol=0, atol=1e-12 / depth**0.5)
    assert times(system, [0.0, 0.0], -depth, t1=2.0, method=method).size == 0


@pytest.mark.slow
@pytest.mark.parametrize(("direction", "expected"), [(-1, [np.pi]), (1, [0.0, 2 * np.pi]), (0, [np.pi, 2 * np.pi])])
def test_directions(direction, expected):
    """sin t from t = 0, where it rises: that is a crossing for +1, the unfired side for -1, neither for 0."""
    system = lh.Hybrid(clockwork, lh.Transition(lambda t, x, args: jnp.sin(x[0]), counter, direction=direction))
    assert_allclose(times(system, [0.0, 0.0], t1=7.0), expected, rtol=0, atol=1e-11)


def test_guards_that_move_and_resets_that_depend_on_time():
    """A falling guard x - vt overtaken at x0/(v - 1); the reset puts x ahead by a multiple of t."""
    system = lh.Hybrid(ones, lh.Transition(lambda t, x, v: x[0] - v * t, lambda t, x, v: x + 0.5 * t))
    # x = 1 + t meets 1.5 t at t = 2, jumps from 3 to 4: 4 + (t - 2) = 1.5 t at t = 4, to 8 …
    assert_allclose(times(system, [1.0], 1.5, t1=20.0), [2, 4, 8, 16], rtol=1e-12)


@pytest.mark.parametrize("says", [True, False])
def test_transitions_that_share_a_guard_are_told_apart_by_when(says):
    first = lh.Transition(lambda t, x, a: 1 - x[0], lambda t, x, a: x - 1.0, when=lambda t, x, a: a)
    second = lh.Transition(lambda t, x, a: 1 - x[0], lambda t, x, a: x - 2.0, when=lambda t, x, a: ~a)
    log = lh.trajectory(lh.Hybrid(ones, [first, second]), [0.0], jnp.asarray(says), t1=1.5, n=2).events
    assert np.asarray(log.transition).tolist() == [0 if says else 1]


# --- on a guard ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS, ids=["adaptive", "fixed"])
@pytest.mark.parametrize("t0", [0.0, 1e4])
def test_a_start_on_the_guard(t0, method):
    """Rising it leaves the floor and does not fire; falling it fires at once; at rest there is no way on."""

    def run(velocity):
        return lh.trajectory(FALLING, [0.0, velocity], 0.5, t0=t0, t1=1.2, n=3, method=method, throw=False)

    rising, falling, resting = run(1.0), run(-1.0), run(0.0)
    assert rising.status is falling.status is STATUS.ok
    assert rising.events.t.size == 0
    assert_allclose(falling.events.t - t0, [0.0, 1.0], rtol=0, atol=1e-11)
    assert_allclose(falling.x[-1], [0.25 * 0.2 - 0.2**2 / 2, 0.25 - 0.2], rtol=0, atol=1e-10)
    assert resting.status is STATUS.deadlock


@pytest.mark.slow
def test_the_tangent_map_of_a_start_on_the_guard_includes_the_jump():
    both = lh.tangent_map(FALLING, [0.0, -1.0], 0.5, t1=0.5)
    assert both.jumps == 1
    # S = [[-r, 0], [(1 + r) g / v, -r]] with g = 1, v = -1 … by the formula; then half a unit of free flight.
    saltation = lh.saltation_matrix(FALLING, 0.0, [0.0, -1.0], 0.5)
    flight = np.array([[1.0, 0.5], [0.0, 1.0]])
    assert_allclose(both.matrix, flight @ saltation, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_a_start_beyond_the_guard_fires_when_it_has_come_back():
    """Half a wave beyond zero is no crossing."""
    system = lh.Hybrid(clockwork, lh.Transition(lambda t, x, args: jnp.sin(x[0]), counter))
    assert_allclose(times(system, [4.0, 0.0], t1=8.0), [3 * np.pi - 4.0], rtol=0, atol=1e-11)


@pytest.mark.slow_cases("fixed")
@pytest.mark.parametrize("method", METHODS, ids=["adaptive", "fixed"])
def test_leaving_a_guard_after_a_reset_neither_fires_again_nor_is_lost(method):
    """Flights of every length from 2 down to 2e-6, each begins and ends on the guard."""
    found = times(FALLING, [0.0, 1.0], 0.5, t1=4 - 4 * 0.5**20, method=method)
    assert_allclose(found, 4 * (1 - 0.5 ** np.arange(1, 20)), rtol=0, atol=1e-9)


# --- cascades ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_cascade_goes_through_in_order_at_one_instant():
    """Each reset throws the state beyond the next guard; the digits of the last component tell the order."""

    def gate(i):
        def reset(t, x, args):
            x = x.at[i].set(1.0).at[3].set(10 * x[3] + i + 1)
            return x.at[i + 1].set(-0.1) if i < 2 else x

        return lh.Transition(lambda t, x, args: x[i], reset)

    system = lh.Hybrid(lambda t, x, args: jnp.stack([-1.0 + 0 * x[0], *(0 * x[1:])]), [gate(i) for i in (2, 0, 1)])
    log = lh.trajectory(system, [0.5, 1.0, 1.0, 0.0], t1=1.0, n=2).events
    assert np.asarray(log.transition).tolist() == [1, 2, 0]
    assert_allclose(log.t, [0.5, 0.5, 0.5], rtol=0, atol=1e-13)
    assert_allclose(log.x_after[-1], [1.0, 1.0, 1.0, 123.0], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_who_is_thrown_beyond_zero_fires_with_the_first_though_the_flow_brought_both_there():
    """Two clocks run out together and each sets off the other: so they do in every neighbour, as the first runs out."""

    def set_off(t, x, args, which):
        fires = jnp.arange(2, dtype=which.dtype) == which
        return jnp.where(fires, 0.0, jnp.where(x == 0, x, x + args))

    pair = lh.Hybrid(ones, lh.Transition(lambda t, x, args: 1 - x, set_off))

    def after(args, x):
        found = lh.tangent_map(pair, x, args, t1=0.8)
        return np.asarray(found.x), np.asarray(found.matrix)

    x, together = after(0.1, [0.5, 0.5])
    ahead, _ = after(0.1, [0.5 + 1e-3, 0.5])
    assert_allclose(ahead - x, [1e-3, 1e-3], atol=1e-12)
    assert_allclose(together, [[1, 0], [1, 0]], atol=1e-12)
    _, apart = after(0.0, [0.5, 0.5])
    assert_allclose(apart, np.eye(2), atol=1e-12)  # left at zero by the other, each has an instant of its own


@pytest.mark.slow
def test_a_reset_that_ends_beyond_its_own_guard_jumps_again():
    """A clock throws V from 0.5 to 3.7; each spike takes 1 from it, down to 0.7; on the way up V = 1 is reached at 1.3.

    So does what the flow brings to the guard and a reset throws beyond it: g(x) ∈ D, until it is not.
    """
    spike = lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: (x - 1.0).at[1].set(2 * x[1]))
    kick = lh.Transition(every=10.0, phase=0.5, reset=lambda t, x, args: x.at[0].add(3.2))
    neuron = lh.Hybrid(clockwork, [spike, kick])
    path = lh.trajectory(neuron, [0.0, 1.0], t1=1.0, n=1)
    log = path.events
    assert np.asarray(log.transition).tolist() == [1, 0, 0, 0, 0]
    assert_allclose(log.t, [0.5, 0.5, 0.5, 0.5, 0.8], rtol=0, atol=1e-13)
    assert_allclose(log.x_after[:, 0], [3.7, 2.7, 1.7, 0.7, 0.0], rtol=0, atol=1e-12)
    assert_allclose(path.x[-1, 0], 0.2, rtol=0, atol=1e-12)
    assert_allclose(lh.tangent_map(neuron, [0.0, 1.0], t1=1.0).matrix, np.diag([1.0, 16.0]), rtol=0, atol=1e-11)

    back = lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.where(x > -1.5, x - 1, x + 4))
    log = lh.trajectory(lh.Hybrid(lambda t, x, args: -jnp.ones_like(x), back), [0.5], t1=0.6, n=1).events
    assert_allclose(log.x_after[:, 0], [-1, -2, 2], rtol=0, atol=1e-12)
    assert_allclose(log.t, [0.5] * 3, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_guards_of_both_directions_are_never_fired_by_a_jump():
    through = lh.Transition(lambda t, x, args: x[0] - 2.0, counter, direction=0)
    over = lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: x.at[0].add(5.0), source="a", target="b")
    system = lh.Hybrid({"a": clockwork, "b": clockwork}, [through, over])
    log = lh.trajectory(system, [0.0, 0.0], t1=3.0, n=2, mode="a").events
    assert np.asarray(log.transition).tolist() == [1]


# --- modes and clocks ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_clocks_tick_only_in_the_modes_that_listen():
    """Ticks at 0.25 + k/2; in "deaf" (from 1.1 to 2.1) they are lost, and the next is in phase."""
    fields = {"hears": clockwork, "deaf": clockwork}
    system = lh.Hybrid(
        fields,
        [
            lh.Transition(every=0.5, phase=0.25, reset=counter, source="hears"),
            lh.Transition(lambda t, x, a: 1.1 - x[0], source="hears", target="deaf", direction=0),
            lh.Transition(lambda t, x, a: 2.1 - x[0], source="deaf", target="hears", direction=0),
        ],
    )
    log = lh.trajectory(system, [0.0, 0.0], t1=3.0, n=2, mode="hears").events
    ticks = np.asarray(log.t)[np.asarray(log.transition) == 0]
    assert_allclose(ticks, [0.25, 0.75, 2.25, 2.75], rtol=0, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0.6, lambda args: 0.6], ids=["number", "function"])
def test_a_tick_while_nobody_listens_does_not_come_late(phase):
    """The last tick before the mode is entered, at 0.6, is over; one at the very instant of the entry comes."""

    def ticks(entry):
        system = lh.Hybrid(
            {"deaf": clockwork, "hears": clockwork},
            [
                lh.Transition(every=10.0, phase=entry, source="deaf", target="hears"),
                lh.Transition(every=1.0, phase=phase, reset=counter, source="hears"),
            ],
        )
        log = lh.trajectory(system, [0.0, 0.0], t1=3.0, n=2, mode="deaf").events
        return np.asarray(log.t)[np.asarray(log.transition) == 1]

    assert_allclose(ticks(0.7), [1.6, 2.6], rtol=0, atol=1e-13)
    assert_allclose(ticks(0.5), [0.6, 1.6, 2.6], rtol=0, atol=1e-13)
    assert_allclose(ticks(0.6), [0.6, 1.6, 2.6], rtol=0, atol=1e-13)
    assert_allclose(ticks(2.6), [2.6], rtol=0, atol=1e-13)


def test_clocks_do_not_drift():
    """A million ticks of 0.1 after t = 1e5 stand at 0.1 k, to the resolution of t."""
    system = lh.Hybrid(lambda t, x, a: 0 * x, lh.Transition(every=0.1, reset=lambda t, x, a: x.at[0].set(t)))
    path = lh.trajectory(system, [0.0], t0=1e5, t1=100.01, n=1)
    assert path.j[-1] == 1000
    assert_allclose(path.x[-1, 0], 100100.0, rtol=0, atol=2e-11)


@pytest.mark.slow
def test_a_chosen_target_and_a_vector_guard():
    """`which` reaches reset and target; modes are counted in the order of the dictionary."""
    fields = {name: ones for name in ("a", "b", "c")}
    jump = lh.Transition(
        lambda t, x, args: args - x[0],
        lambda t, x, args, which: 0 * x,
        target=lambda t, x, args, which: which + 1,
        source="a",
    )
    path = lh.trajectory(lh.Hybrid(fields, jump), [0.0], jnp.asarray([0.7, 0.4]), t1=1.0, n=2, mode="a")
    assert path.mode[-1] == 2
    assert_allclose(path.x[-1], [0.6], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_numpy_matrix_among_the_parameters_is_taken_at_which():
    """Two leaky neurons that inhibit each other: 0, and the known exponent of their antiphase orbit."""

    def spike(t, x, args, which):
        return (x + args["W"][:, which]).at[which].set(0.0)

    def field(t, x, args):
        return args["current"] - x

    neurons = lh.Hybrid(field, lh.Transition(lambda t, x, args: 1.0 - x, spike))
    args = {"W": np.array([[0.0, -0.1], [-0.1, 0.0]]), "current": np.full(2, 2.0)}
    found = lh.lyapunov_spectrum(neurons, [0.6326, 0.4684], args, t1=200.0, transient=100.0)
    assert_allclose(found.exponents, [0.0, -0.1851059509884756], rtol=0, atol=2e-3)


# --- under transformation ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_derivative_of_an_event_time():
    """Impact at τ = √(2 x0), rebound r τ: x(t) = r τ (t - τ) - (t - τ)²/2, differentiated by hand."""

    def height(x0):
        return lh.trajectory(FALLING, jnp.stack([x0, jnp.zeros_like(x0)]), 0.5, t1=1.4, n=2).x[-1, 0]

    value, slope = jax.jvp(height, (jnp.asarray(0.5),), (jnp.asarray(1.0),))
    assert_allclose(value, 0.5 * 0.4 - 0.4**2 / 2, rtol=0, atol=1e-11)
    assert_allclose(slope, 0.5 * 0.4 - 0.5 * 1.0 + 0.4, rtol=0, atol=1e-9)  # dτ/dx0 = 1/τ = 1


def test_as_many_units_as_there_are_may_fire_together():
    """Twenty equal neurons: twenty jumps at each instant, and a period of ln 6 each."""
    neurons = lh.Hybrid(
        lambda t, v, args: 1.2 - v, lh.Transition(lambda t, v, args: 1 - v, lambda t, v, args, i: v.at[i].set(0.0))
    )
    run = lh.trajectory(neurons, np.zeros(20), t1=10.0, n=2)
    assert len(run.events.t) == 20 * int(10 / np.log(6))
    np.testing.assert_allclose(run.events.t, np.repeat(np.log(6) * np.arange(1, 6), 20), rtol=1e-9)
