"""What turns a direction exactly into the kernel of a jump: rounding hides the loss, which is seen or said."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo

PRODUCT = lh.Map(lambda n, x, args: args[jnp.asarray(n, jnp.int32) % 3] @ x)


@pytest.mark.slow_cases("5-11", "2-7")
@pytest.mark.parametrize(("a", "b"), [(3, 7), (5, 11), (2, 7)])
def test_a_regular_matrix_turns_an_image_into_a_kernel(a, b):
    """(a, b) is turned to (0, a + b), which the third matrix destroys: the product is zero."""
    matrices = np.array([[[a, 2 * a], [b, 2 * b]], [[b, -a], [1, 1]], [[1, 0], [2, 0]]], float)
    spectrum = lh.lyapunov_spectrum(PRODUCT, [0.0, 0.0], matrices, t1=6, blocks=2)
    assert spectrum.exponents.tolist() == [-np.inf, -np.inf]
    assert spectrum.notes >= {"rank_lost", "unresolved"}


def turned(kept, angle):
    """A rotation by an angle between resets (x, y) -> (x, kept y)."""
    turn = jnp.array([[0.0, -angle], [angle, 0.0]])
    return lh.Hybrid(
        lambda t, x, args: turn @ x,
        lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: x * jnp.array([1.0, kept])),
    )


@pytest.mark.slow_cases("1e-09")
@pytest.mark.parametrize("rtol", [1e-9, 1e-12])
def test_a_flow_turns_an_image_into_a_kernel(rtol):
    """By a right angle: the first reset leaves (1, 0), which is (0, 1) at the second, and lost."""
    method = lh.RungeKutta(rtol=rtol)
    spectrum = lh.lyapunov_spectrum(turned(0.0, np.pi / 2), [1.0, 1.0], t1=8.0, blocks=2, method=method)
    assert spectrum.exponents[1] == -np.inf
    assert spectrum.exponents[0] == -np.inf or "unresolved" in spectrum.notes


@pytest.mark.slow_cases("1e-11", "1e-06")
@pytest.mark.parametrize("kept", [1e-6, 1e-11, 1e-30])
def test_a_reset_that_makes_a_direction_short_is_no_loss(kept):
    spectrum = lh.lyapunov_spectrum(turned(kept, 0.0), [1.0, 1.0], t1=8.0, blocks=2)
    assert_allclose(spectrum.exponents, [0.0, np.log(kept)], atol=1e-12)
    assert spectrum.notes == frozenset()


@pytest.mark.slow
@pytest.mark.parametrize("kept", [1e-6, 1e-30])
def test_a_short_direction_that_errors_of_the_flow_make_longer_is_flagged(kept):
    """Turned by right angles the two directions share ln kept, unless the error of the turn is longer than `kept`."""
    spectrum = lh.lyapunov_spectrum(turned(kept, np.pi / 2), [1.0, 1.0], t1=8.0, blocks=2)
    right = np.allclose(spectrum.exponents, 0.5 * np.log(kept), rtol=0, atol=1e-3)
    assert right == (kept > 1e-9)
    assert spectrum.notes == (frozenset() if right else {"unresolved"})


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.54, 0.7, 0.9])
def test_a_loss_for_which_a_mode_has_no_room_is_no_rounding(alpha):
    """A block that sticks moves with the velocity 1e-17 of rounding: the direction that it loses is v all the same."""
    stuck = zoo.block_on_plate(alpha=alpha).spectrum()
    assert_allclose(stuck.exponents, [0.0, -np.inf], atol=1e-12)
    assert stuck.notes == {"rank_lost"}


def test_a_loss_that_the_slowness_of_a_flow_may_fake_is_flagged_in_a_mode_with_room():
    """The direction of the flow, alone in the frame, becomes as short as the flow becomes slow: 1e-17, or zero."""


@pytest.mark.slow
@pytest.mark.parametrize("t0", [0.07, 0.085, 0.0875])
def test_a_body_put_to_rest_on_a_moving_table_forgets_its_past(t0):
    """At rest the state is a function of time; rounding tells the table's velocity from the derivative of its place."""

    def table(t, args):
        size, omega = args
        return size * jnp.array([jnp.sin(omega * t), omega * jnp.cos(omega * t), -(omega**2) * jnp.sin(omega * t)])

    lands = lh.Transition(
        lambda t, x, args: x[0] - table(t, args)[0],
        lambda t, x, args: table(t, args)[:2],
        source="flight",
        target="rest",
    )
    fields = {"flight": lambda t, x, args: jnp.array([x[1], -9.81]), "rest": lambda t, x, args: table(t, args)[1:]}
    ball, args = lh.Hybrid(fields, lands), (0.02, 20 * np.pi)
    start = table(t0, args)[:2] + jnp.array([1e-9, -5e-5])
    found = lh.lyapunov_spectrum(ball, start, args, mode="flight", t0=t0, t1=0.002, blocks=2)
    assert found.jumps == 1
    assert found.losses.tolist() == [1, 1]


TURNED = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


@pytest.mark.parametrize(
    ("period", "turned", "is_right"),
    [(5.0, True, True), (60.0, False, True), pytest.param(100.0, True, False), pytest.param(100.0, False, True)],
)
def test_what_shrinks_between_rare_losses_is_flagged(period, turned, is_right):
    """Exponents 0, −1, −∞: one neutral direction is forgotten at each tick, and rounding along it outgrows e^−t."""
    basis = jnp.asarray(TURNED if turned else np.eye(3))
    rates, kept = (
        basis @ jnp.diag(jnp.array([0.0, 0.0, -1.0])) @ basis.T,
        basis @ jnp.diag(jnp.array([1.0, 0, 1])) @ basis.T,
    )
    tick = lh.Transition(every=period, reset=lambda t, x, args: kept @ x)
    spectrum = lh.lyapunov_spectrum(lh.Hybrid(lambda t, x, args: rates @ x, tick), [1.0, 1.0, 1.0], t1=1000.0)
    assert ("unresolved" in spectrum.notes) == (period > 36.0)
    if is_right:
        assert_allclose(spectrum.exponents, [0.0, -1.0, -np.inf], atol=5e-3)


def slips(sign):
    return lambda t, x, rate: jnp.stack([x[1], -x[0] - 0.4 * sign + jnp.cos(0.3 * t), rate * (x[0] - x[2])])


@pytest.mark.slow_cases("4.0")
@pytest.mark.parametrize("rate", [2.0, 4.0, 5.0])
def test_rounding_across_a_sliding_mode_does_not_grow(rate):
    """A filter of the place of a block that sticks for 5.1 and slips for 5.4: its exponent is minus its rate."""
    block = lh.filippov(slips(1.0), slips(-1.0), surface=lambda t, x, args: x[1])
    turn = 2 * np.pi / 0.3
    spectrum = lh.lyapunov_spectrum(block, [0.5, 1.0, 0.0], rate, t1=20 * turn, transient=5 * turn)
    assert_allclose(spectrum.exponents[1], -rate, rtol=1e-3)
    assert spectrum.notes == {"rank_lost"}


def test_losses_that_take_turns_reset_the_shares():
    """Two neutral directions are forgotten every 2, each at its own time: between losses e^−t shrinks by e^−2 only."""
    basis = jnp.asarray(np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0])
    rates = basis @ jnp.diag(jnp.array([0.0, 0.0, 0.0, -1.0])) @ basis.T

    def forgets(i, phase):
        kept = basis @ jnp.diag(jnp.ones(4).at[i].set(0.0)) @ basis.T
        return lh.Transition(every=2.0, phase=phase, reset=lambda t, x, args: kept @ x)

    system = lh.Hybrid(lambda t, x, args: rates @ x, [forgets(1, 0.0), forgets(2, 1.0)])
    spectrum = lh.lyapunov_spectrum(system, np.ones(4), t1=200.0)
    assert spectrum.notes == {"rank_lost"}
    assert_allclose(spectrum.exponents, [0.0, -1.0, -np.inf, -np.inf], atol=0.02)


@pytest.mark.parametrize("verb", [lh.covariant_vectors, lh.svd_spectrum])
def test_verbs_without_notes_warn(verb):
    tick = lh.Transition(every=100.0, reset=lambda t, x, args: x * jnp.array([1.0, 0.0, 1.0]))
    system = lh.Hybrid(lambda t, x, args: x * jnp.array([0.0, 0.0, -1.0]), tick)
    with pytest.warns(UserWarning, match="unresolved: .* a direction shrank too much between two losses"):
        verb(system, [1.0, 1.0, 1.0], t1=1000.0)
