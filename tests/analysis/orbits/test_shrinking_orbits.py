"""Branches of limit cycles that shrink to an equilibrium, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

AROUND = {"args": (-0.5, 1.0)}


def kinds(branch):
    return [special.kind for special in branch.specials]


def circling(growth):
    """The flow r' = r growth(r², args), θ' = 2."""

    def field(t, x, args):
        rate = growth(x @ x, args)
        return jnp.stack([rate * x[0] - 2 * x[1], 2 * x[0] + rate * x[1]])

    return field


def fitzhugh_nagumo(t, x, current):
    return jnp.stack([x[0] - x[0] ** 3 / 3 - x[1] + current, 0.3 * (x[0] + 0.7 - 0.8 * x[1])])


def brusselator(t, x, b):
    return jnp.stack([1 + x[0] ** 2 * x[1] - (b + 1) * x[0], b * x[0] - x[0] ** 2 * x[1]])


def lorenz(t, x, rho):
    return jnp.stack([10 * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]])


@pytest.fixture(scope="module")
def supercritical():
    return lh.continuation(lh.Flow(circling(lambda square, m: m - square)), [0.5, 0.0], 0.25, over=AROUND)


@pytest.mark.slow
def test_a_branch_ends_at_its_hopf_point(supercritical):
    assert supercritical.ends == ("Hopf", "range")
    (hopf,) = supercritical.of_kind("Hopf")
    assert kinds(supercritical) == ["Hopf"]
    assert (hopf.parameter, hopf.period) == pytest.approx((0.0, np.pi), abs=1e-12)
    assert_allclose(hopf.x0, 0, atol=1e-12)
    assert_allclose(hopf.largest, 0, atol=1e-12)
    assert_allclose(hopf.multipliers, 1, atol=1e-10)
    assert hopf.orbit.residual < 1e-12
    # No orbit twice: along the branch they grow, each with a valid residual.
    assert_allclose(np.linalg.norm(supercritical.x0, axis=1), np.sqrt(supercritical.values), atol=1e-11)
    assert np.all(np.diff(supercritical.values) > 0)
    assert 0 < supercritical.values[0] < 1e-4
    assert np.all(supercritical.stable)
    assert max(orbit.residual for orbit in supercritical.orbits) < 1e-9


@pytest.mark.slow
def test_it_stays_so_in_a_wider_range(supercritical):
    wider = supercritical.resume(over={"args": (-1.0, 1.2)})
    assert (wider.ends, kinds(wider)) == (("Hopf", "range"), ["Hopf"])
    assert np.max(wider.values) == 1.2


def test_no_branch_or_curve_begins_at_a_hopf_point(supercritical):
    hopf, system = supercritical.specials[0], lh.Flow(circling(lambda square, m: m[0] - m[1] * square))
    with pytest.raises(ValueError, match="No branch begins at a Hopf"):
        lh.continuation(system, hopf, 0.25, over=AROUND)
    with pytest.raises(ValueError, match="No curve begins at a Hopf point: there the orbit is an equilibrium"):
        lh.bifurcation_curve(system, hopf, np.array([0.0, 1.0]), over={"args[0]": (-1, 1), "args[1]": (0.5, 2)})


def test_the_picture_marks_it(supercritical):
    upper, _ = supercritical.plot()
    assert "Hopf" in [text.get_text() for text in upper.get_legend().get_texts()]


@pytest.mark.slow
def test_a_range_that_ends_before_the_hopf_point():
    system = lh.Flow(circling(lambda square, m: m - square))
    branch = lh.continuation(system, [0.5, 0.0], 0.25, over={"args": (1e-4, 0.3)})
    assert (branch.ends, branch.specials) == (("range", "range"), ())
    assert np.min(branch.values) == 1e-4


@pytest.mark.parametrize("b", [1.0, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_a_fold_between_a_subcritical_hopf_point_and_the_cycles(b):
    """R' = m r + b r³ − r⁵: the fold is at m = −b²/4, however near to the Hopf point at 0."""
    system = lh.Flow(circling(lambda square, m: m + b * square - square**2))
    branch = lh.continuation(system, [np.sqrt((b + np.sqrt(b**2 + 0.4)) / 2), 0.0], 0.1, over={"args": (-0.5, 0.2)})
    assert (branch.ends, kinds(branch)) == (("Hopf", "range"), ["Hopf", "fold"])
    assert [special.parameter for special in branch.specials] == pytest.approx([0.0, -(b**2) / 4], abs=1e-12)


@pytest.mark.parametrize("segments", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_fitzhugh_nagumo_between_two_hopf_points(segments):
    """The trace of the Jacobian is zero where v² = 1 − 0.24; ω² is its determinant."""
    branch = lh.continuation(
        lh.Flow(fitzhugh_nagumo), [0.0, 0.0], 0.8, over={"args": (0.0, 2.0)}, transient=100.0, segments=segments
    )
    v = np.sqrt(0.76) * np.array([-1, 1])
    currents, period = (v + 0.7) / 0.8 - v + v**3 / 3, 2 * np.pi / np.sqrt(0.3 - 0.24**2)
    assert branch.ends == ("Hopf", "Hopf")
    assert sorted(kinds(branch)) == ["Hopf", "Hopf", "fold", "fold"]
    assert sorted(one.parameter for one in branch.of_kind("Hopf")) == pytest.approx(currents, abs=1e-10)
    assert [one.period for one in branch.of_kind("Hopf")] == pytest.approx([period] * 2, rel=1e-10)
    assert_allclose(sorted(one.x0[0] for one in branch.of_kind("Hopf")), v, atol=1e-9)
    folds = sorted(one.parameter for one in branch.of_kind("fold"))
    assert folds == pytest.approx([0.41674736, 1.33325264], abs=1e-8)  # computed by integration
    assert sum(folds) == pytest.approx(sum(currents), abs=1e-9)  # (v, w, I − 7/8) ↦ −(v, w − 7/8, I − 7/8)


@pytest.mark.parametrize("modulo", [None, pytest.param(lambda x: -x, marks=pytest.mark.slow)])
def test_a_cycle_with_a_symmetry(modulo):
    system = lh.Flow(circling(lambda square, m: m - square))
    branch = lh.continuation(system, [0.5, 0.0], 0.25, over={"args": (-0.5, 0.3)}, modulo=modulo)
    assert (branch.ends, kinds(branch)) == (("Hopf", "range"), ["Hopf"])
    assert branch.specials[0].parameter == pytest.approx(0.0, abs=1e-12)
    assert branch.specials[0].period == pytest.approx(np.pi / (1 if modulo is None else 2), abs=1e-12)


@pytest.mark.slow
def test_the_brusselator_has_no_cycle_below_its_hopf_point():
    branch = lh.continuation(lh.Flow(brusselator), [1.5, 2.0], 2.3, over={"args": (1.8, 2.5)}, transient=100.0)
    assert (branch.ends, kinds(branch)) == (("Hopf", "range"), ["Hopf"])
    assert (branch.specials[0].parameter, branch.specials[0].period) == pytest.approx((2.0, 2 * np.pi), abs=1e-11)
    assert np.min(branch.values) > 2
    assert np.all(branch.stable)


@pytest.mark.slow
def test_unstable_cycles_of_lorenz_shrink_as_the_parameter_grows():
    """The subcritical Hopf point is at ρ = σ (σ + β + 3)/(σ − β − 1), with ω² = β (ρ + σ)."""
    branch = lh.continuation(lh.Flow(lorenz), [4.0, 2.0, 21.8], 21.0, over={"args": (18.0, 30.0)})
    rho, (hopf,) = 470 / 19, branch.specials
    assert branch.ends == ("range", "Hopf")
    assert (hopf.kind, hopf.parameter) == ("Hopf", pytest.approx(rho, abs=1e-9))
    assert hopf.period == pytest.approx(2 * np.pi / np.sqrt(8 / 3 * (rho + 10)), abs=1e-10)
    assert hopf.multipliers[-1] == pytest.approx(np.exp(-(10 + 1 + 8 / 3) * hopf.period), rel=1e-4)


@pytest.mark.slow
def test_a_cycle_with_a_constraint():
    def residual(t, x, m):
        rate = m - x[2]
        return jnp.stack(
            [rate * x[0] - 2 * x[1] + 0.3 * x[2], 2 * x[0] + rate * x[1], x[2] - x[0] ** 2 - x[1] ** 2 - 0.1 * m]
        )

    dae = lh.DAE(lambda t, m: jnp.diag(jnp.array([1.0, 1.0, 0.0])), residual, 2)
    branch = lh.continuation(dae, [0.5, 0.0, 0.275], 0.25, over=AROUND, transient=50.0)
    assert (branch.ends, kinds(branch)) == (("Hopf", "range"), ["Hopf"])
    assert (branch.specials[0].parameter, branch.specials[0].period) == pytest.approx((0.0, np.pi), abs=1e-11)


# --- with events -----------------------------------------------------------------------------------------------------


def behind(threshold, inner, outer):
    """One field below a threshold of x₀, another one beyond it."""
    return lh.Hybrid(
        {"in": inner, "out": outer},
        [
            lh.Transition(lambda t, x, args: threshold - x[0], None, source="in", target="out"),
            lh.Transition(lambda t, x, args: x[0] - threshold, None, source="out", target="in"),
        ],
        initial_mode=lambda t, x, args: jnp.where(x[0] > threshold, 1, 0),
    )


@pytest.mark.slow
def test_a_cycle_that_first_leaves_a_threshold_and_then_shrinks():
    def outer(t, x, m):
        rate = m - (x @ x) * (1 + 5 * (x[0] - 0.1) ** 2)
        return jnp.stack([rate * x[0] - 2 * x[1], 2 * x[0] + rate * x[1]])

    system = behind(0.1, circling(lambda square, m: m - square), outer)
    branch = lh.continuation(system, [-0.6, 0.0], 0.49, over=AROUND, transient=100.0)
    assert (branch.ends, kinds(branch)) == (("Hopf", "range"), ["Hopf", "grazing"])
    assert [special.parameter for special in branch.specials] == pytest.approx([0.0, 0.01], abs=1e-9)


@pytest.mark.slow
def test_events_that_change_nothing_leave_the_hopf_point():
    recorded = lh.Hybrid(circling(lambda square, m: m - square), lh.Transition(lambda t, x, m: x[0], None))
    branch = lh.continuation(recorded, [0.5, 0.1], 0.25, over={"args": (-0.5, 0.5)})
    assert (branch.ends, kinds(branch)) == (("Hopf", "range"), ["Hopf"])
    assert branch.specials[0].parameter == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_a_cycle_that_shrinks_to_an_equilibrium_on_a_border():
    """X' = T x − y, y' = x − m with T = −1 and 0.4 on both sides of x = 0: all cycles are alike, of size ∝ m."""

    def of(trace):
        return lambda t, x, m: jnp.stack([trace * x[0] - x[1], x[0] - m])

    system = behind(0.0, of(-1.0), of(0.4))
    branch = lh.continuation(system, [1.0, -0.5], 0.5, over={"args": (-1.0, 1.0)}, transient=100.0)
    assert (branch.ends, kinds(branch)) == (("boundary equilibrium", "range"), ["boundary equilibrium"])
    assert branch.specials[0].parameter == pytest.approx(0.0, abs=1e-9)
    assert_allclose(branch.largest[:, 0] / branch.values, branch.largest[-1, 0], rtol=1e-3)
    assert_allclose(branch.period, branch.period[-1], rtol=1e-6)
    assert np.all(branch.values > 0)


# --- where a small orbit is like any other ---------------------------------------------------------------------------


@pytest.mark.slow
def test_a_forced_response_passes_through_rest():
    """X'' + 0.2 x' + x = F cos 2t: the response is F times one orbit, for F of both signs."""

    def forced(t, x, force):
        return jnp.stack([x[1], -0.2 * x[1] - x[0] + force * jnp.cos(2 * t)])

    branch = lh.continuation(lh.Flow(forced), [0.0, 0.0], 0.1, over={"args": (-0.3, 0.3)}, period=np.pi)
    assert (branch.ends, branch.specials) == (("range", "range"), ())
    assert_allclose(branch.x0, branch.values[:, None] * np.array([-3, 0.8]) / 9.16, atol=1e-10)


@pytest.mark.slow
def test_a_family_reaches_its_equilibrium():
    """A family has no Hopf point: its lowest energy is that of the equilibrium, where it meets itself."""
    pendulum = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
    family = lh.continuation(pendulum, [1.0, 0.0], over=(-1.2, 0.5), conserve=True)
    assert (family.ends[1], kinds(family)) == ("range", ["pitchfork"])
    assert_allclose(family.values.min(), -1.0, atol=1e-12)


# --- in two parameters -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_curve_of_folds_ends_at_the_generalised_hopf_point():
    """R' = m r + b r³ − r⁵ folds on m = −b²/4 with r² = b/2, from b = 0 on."""
    system = lh.Flow(circling(lambda square, args: args["m"] + args["b"] * square - square**2))
    args, over = {"m": 0.1, "b": 1.0}, {"m": (-0.5, 0.2), "b": (-1.0, 1.2)}
    branch = lh.continuation(system, [1.04, 0.0], args, over={"m": over["m"]})
    curve = lh.bifurcation_curve(system, branch.of_kind("fold")[0], args, over=over)
    m, b = curve.values.T
    assert sorted(curve.ends) == ["Hopf", "range"]
    assert_allclose(m, -(b**2) / 4, atol=1e-11)
    assert np.min(b) > 0
    assert np.max(b) == 1.2
    (end,) = curve.specials
    assert end.kind == "Hopf"
    assert_allclose(end.values, 0, atol=1e-9)
    assert end.orbit.residual < 1e-12
    curve.plot()
