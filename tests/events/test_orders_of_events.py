"""Several events due at one instant: where their order matters a note says so, and clocks keep that of the list."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

# --- one jump sends several guards beyond zero ------------------------------------------------------------------------


def pair(weight):
    """Two leaky neurons; an input lifts both over the threshold at once, a spike moves the other one by a weight."""
    fire = lh.Transition(
        lambda t, v, args: 1 - v,
        lambda t, v, args, which: (v + weight).at[which].set(0.0),
    )
    lift = lh.Transition(every=1.0, reset=lambda t, v, args: v + 0.8)
    return lh.Hybrid(lambda t, v, args: args - v, [fire, lift])


@pytest.mark.slow
def test_which_of_two_neurons_fires_first_is_noted_where_it_matters():
    drive = jnp.array([0.9, 0.8])
    inhibited = lh.lyapunov_spectrum(pair(-0.6), [0.8, 0.7], drive, t1=50.0)
    assert "simultaneous" in inhibited.notes
    apart = lh.lyapunov_spectrum(pair(0.0), [0.8, 0.7], drive, t1=50.0)
    assert "simultaneous" not in apart.notes
    for weight in (-0.6, 0.0):
        found = lh.tangent_map(pair(weight), [0.8, 0.7], drive, t1=2.5)
        assert found.notes == ({"simultaneous"} if weight else set())


@pytest.mark.slow
def test_where_later_orders_matter_the_solutions_are_not_all():
    drive = jnp.array([0.9, 0.8])
    assert not lh.solutions(pair(-0.6), [0.8, 0.7], drive, t1=3.0).complete
    assert lh.solutions(pair(0.0), [0.8, 0.7], drive, t1=3.0).complete


@pytest.mark.slow
def test_two_pairs_that_reach_the_threshold_together():
    """One of each pair wins: four ends, of which the choice of the first spike alone finds three."""
    weights = -0.5 * np.kron(np.eye(2), [[0.0, 1.0], [1.0, 0.0]])
    fire = lh.Transition(
        lambda t, v, args: 1 - v, lambda t, v, args, which: (v + jnp.asarray(weights)[:, which]).at[which].set(0.0)
    )
    found = lh.solutions(lh.Hybrid(lambda t, v, args: 1.5 - v, fire), [0.5] * 4, t1=0.8)
    assert not found.complete
    assert {tuple(np.flatnonzero(np.asarray(one.spectrum.x) < 0.5)) for one in found.solutions} <= {
        (0, 2), (0, 3), (1, 2), (1, 3)
    }  # fmt: skip


# --- clocks -----------------------------------------------------------------------------------------------------------

GROW, ADD = (lambda t, x, args: 2 * x), (lambda t, x, args: x + 1)


@pytest.mark.slow_cases("grow")
@pytest.mark.parametrize("first", ["grow", "add"])
def test_clocks_that_tick_together_do_so_in_the_order_of_the_list(first):
    """0.1 · 3 k is above or below 0.3 · k as it rounds."""
    grow, add = lh.Transition(every=0.1, reset=GROW), lh.Transition(every=0.3, reset=ADD)
    clocks = [grow, add] if first == "grow" else [add, grow]
    run = lh.trajectory(lh.Hybrid(lambda t, x, args: -10 * x, clocks), [1.0], t1=6.05, n=1)
    times, transitions = run.events.t, run.events.transition
    together = np.flatnonzero(np.diff(times) < 0.01)
    assert len(together) == 20
    assert np.all(transitions[together] == 0)
    assert np.all(transitions[together + 1] == 1)
    x = 1.0
    for tick in range(1, 61):  # by hand
        x *= np.exp(-1.0)
        for name in ("grow", "add") if first == "grow" else ("add", "grow"):
            x = 2 * x if name == "grow" else x + (tick % 3 == 0)
    assert run.x[-1, 0] == pytest.approx(x * np.exp(-0.5), rel=1e-7)


@pytest.mark.slow
def test_derivatives_by_the_period_of_clocks_that_tick_together():
    """Each clock's own period moves its own ticks."""
    system = lh.Hybrid(
        lambda t, x, args: -x,
        [lh.Transition(every=lambda args: args[0], reset=GROW), lh.Transition(every=lambda args: args[1], reset=ADD)],
    )

    def end(args):
        return lh.trajectory(system, jnp.array([1.0]), args, t1=1.0, n=1).x[-1, 0]

    found = np.asarray(jax.jacfwd(end)(jnp.array([0.7, 0.7])))
    # x(1) = (2 e^{-p} e^{-(q - p)} + 1) e^{-(1 - q)} with p < q; the order of the list holds at p = q, too.
    assert found == pytest.approx([0.0, np.exp(-0.3)], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.0, 1e-4])
def test_two_parts_change_their_modes_at_one_instant(apart):
    """Each x' = 1 below zero and 3 above, so that dx(t)/dx(0) = 3 after it; every pair of sides is a mode."""

    def field(*slopes):
        return lambda t, x, args: jnp.array(slopes)

    def rises(i):
        return lambda t, x, args: x[i]

    pair = lh.Hybrid(
        {"--": field(1.0, 1.0), "+-": field(3.0, 1.0), "-+": field(1.0, 3.0), "++": field(3.0, 3.0)},
        [
            lh.Transition(rises(0), source="--", target="+-", direction=1),
            lh.Transition(rises(1), source="--", target="-+", direction=1),
            lh.Transition(rises(1), source="+-", target="++", direction=1),
            lh.Transition(rises(0), source="-+", target="++", direction=1),
        ],
    )
    found = lh.tangent_map(pair, [-1.0, -1.0 - apart], t1=2.0, mode="--")
    assert_allclose(found.matrix, 3 * np.eye(2), rtol=0, atol=1e-12)
    run = lh.lyapunov_spectrum(pair, [-1.0, -1.0 - apart], t1=2.0, mode="--", transient=0.0, blocks=2)
    assert "simultaneous" not in run.notes


# --- an edge, charges: what rounding and units must not hide ----------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("corner", [(0.0, 0.0), (0.1, -3.0)])
def test_both_ways_out_of_an_edge_wherever_it_is(corner):
    """A particle is aimed at the edge of a wedge; by hand it leaves by one way or the other."""
    corner = np.array(corner)

    def solutions(angle, part, length):
        walls = np.array([[0.0, 1.0], [np.sin(angle), -np.cos(angle)]])

        def field(t, x, args):
            return jnp.concatenate([x[2:], 0 * x[2:]])

        def hit(t, x, args, which):
            n = jnp.asarray(walls)[which]
            return x.at[2:].add(-2 * n * (n @ x[2:]))

        wedge = lh.Hybrid(field, lh.Transition(lambda t, x, args: walls @ (x[:2] - corner), hit))
        inwards = -np.array([np.cos(part * angle), np.sin(part * angle)])
        return lh.solutions(wedge, [*(corner - length * inwards), *inwards], t1=1.5)

    for angle, part, length in ((0.9, 0.5, 0.7), (0.9, 0.5, 0.5), (1.0, 0.3, 0.7), (1.05, 0.37, 0.7)):
        assert len(solutions(angle, part, length).solutions) == 2


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e-12])
def test_orders_differ_by_a_small_component_too(unit):
    """Two timers end at one instant, and each sets a charge: the last one decides."""

    def rates(t, x, args):
        return jnp.stack([1 + 0 * x[0], 1 + 0 * x[1], 0 * x[2]])

    timers = [
        lh.Transition(lambda t, x, args, i=i: 1 - x[i], lambda t, x, args, i=i, q=q: x.at[i].set(0.0).at[2].set(q))
        for i, q in enumerate((unit, 2 * unit))
    ]
    found = lh.solutions(lh.Hybrid(rates, timers), [0.0, 0.0, 5 * unit], t1=1.5)
    ends = sorted(float(one.spectrum.x[2]) / unit for one in found.solutions)
    assert_allclose(ends, [1.0, 2.0], rtol=1e-12)


CORNERS = [(1.0, 0.3, {"simultaneous"}), (1.1, 0.3, set()), (1.0, 0.0, set())]


@pytest.mark.parametrize(("height", "mixed", "notes"), CORNERS)
def test_trajectories_note_that_an_order_matters(height, mixed, notes):
    """Two walls that are met at one instant; each adds part of the other velocity, and such resets do not commute."""
    corner = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[2], x[3], 0 * x[0], 0 * x[0]]),
        [
            lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], x[1], -x[2] + mixed * x[3], x[3]])),
            lh.Transition(lambda t, x, a: x[1], lambda t, x, a: jnp.stack([x[0], x[1], x[2] + mixed * x[3], -x[3]])),
        ],
    )
    found = lh.trajectory(corner, [1.0, height, -1.0, -1.0], t1=1.5)
    assert found.notes == notes
    assert ("simultaneous:" in str(found)) == bool(notes)
