"""Fu, Wang & Wang: equations (5) to (10), the scheme that is wrong at every stick, and Figs. 1 to 4."""

import csv
import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

import lyaphybrid as lh
import references
from lyaphybrid import zoo
from lyaphybrid.__main__ import main
from lyaphybrid.papers import claims, output
from lyaphybrid.papers.fu import bifurcations as fu_bifurcations
from lyaphybrid.papers.fu import cases, synchronisation
from lyaphybrid.papers.fu import checks as fu_checks
from lyaphybrid.papers.fu import figures as fu_figures
from lyaphybrid.papers.fu import report as fu_report
from lyaphybrid.papers.fu import reproduction as fu
from lyaphybrid.papers.fu import transfer_matrices as tm

PLUS, MINUS, STICK = range(3)  # in `tm.FIELDS`
MODES = ("plus", "minus", "sliding")  # the same in the zoo
STEPS = (1e-1, 1e-3, 1e-6)


def pendulum(alpha):
    problem = zoo.friction_pendulum(beta=0.052, alpha=alpha, form="autonomous")
    return problem.system, {name: jnp.asarray(value, float) for name, value in problem.args.items()}


def force(x, args):
    return float(args["amplitude"] * jnp.sin(args["omega"] * x[2]) - args["gravity"] * jnp.sin(x[0]))


def at_force(wanted, args, z=1.0):
    """A state at rest where A sin ωz − λ sin θ has this value."""
    theta = np.arcsin((float(args["amplitude"]) * np.sin(float(args["omega"]) * z) - wanted) / float(args["gravity"]))
    return jnp.array([theta, 0.0, z])


def crossing(name):
    """(fields before and after, guard, state, args), and the modes, of the three kinds of transition."""
    _, args = pendulum(0.5)
    if name == "slip to stick":  # t₁ of the paper
        return (PLUS, STICK), tm.GUARDS[0], at_force(0.2, args), args
    if name == "stick to slip":  # t₂
        return (STICK, PLUS), tm.GUARDS[1], at_force(0.5, args), args
    return (PLUS, MINUS), tm.GUARDS[0], at_force(-0.3, args), args | {"alpha": jnp.asarray(0.1)}


NAMES = ("slip to stick", "stick to slip", "slip to slip")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dt", STEPS)
def test_an_euler_step_of_the_transfer_matrix_is_s_after_a_step_of_the_old_field(name, dt):
    """Equations (5) to (10)."""
    (before, after), guard, x, args = crossing(name)
    before, after = tm.FIELDS[before], tm.FIELDS[after]
    matrix = tm.transfer_matrix(before, after, guard, x, args, dt)
    s, old = tm.saltation(before, after, guard, x, args), jnp.eye(3) + dt * jax.jacfwd(before)(x, args)
    np.testing.assert_allclose(tm.step_matrix(matrix, dt, "euler"), s @ old, rtol=0, atol=1e-14)


def test_the_two_transfer_matrices_that_are_printed():
    dt = 1e-3
    for name, jac, one_and_jac in (
        ("slip to stick", np.diag([0.0, -1.0, 0.0]), np.diag([1.0, 0.0, 1.0])),
        ("stick to slip", np.zeros((3, 3)), np.eye(3)),
    ):
        (before, after), guard, x, args = crossing(name)
        found = tm.transfer_matrix(tm.FIELDS[before], tm.FIELDS[after], guard, x, args, dt)
        printed = jac / dt + one_and_jac @ np.asarray(jax.jacfwd(tm.FIELDS[before])(x, args))
        np.testing.assert_allclose(found, printed, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_saltation_of_the_paper_is_that_of_the_package(name):
    modes, guard, x, args = crossing(name)
    system, _ = pendulum(0.5)
    event = {"transition": modes[0], "which": 0 if name == "stick to slip" else None}
    before, after = (tm.FIELDS[mode] for mode in modes)
    theirs = tm.saltation(before, after, guard, x, args)
    ours = lh.saltation_matrix(system, 0.0, x, args, mode=MODES[modes[0]], **event)
    f, r = force(x, args), 0.0
    if name == "slip to slip":
        r = (f + 0.1) / (f - 0.1)
        assert 0 < r < 1
    expected = np.eye(3) if name == "stick to slip" else np.diag([1.0, r, 1.0])
    np.testing.assert_allclose(theirs, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize(("r", "kept"), [(0.0, 0.375), (0.5, 0.607), (1.0, 1.0)])
def test_rk4_applies_a_polynomial_instead_of_r(r, kept, dt):
    matrix = jnp.diag(jnp.array([0.0, r - 1, 0.0])) / dt
    found = float(tm.step_matrix(matrix, dt, "rk4")[1, 1])
    assert abs(found - tm.fourth_order(r - 1)) < 1e-14
    assert abs(found - kept) < 1e-3
    assert abs(float(tm.step_matrix(matrix, dt, "euler")[1, 1]) - r) < 1e-14


def test_step_matrix_is_a_step_of_each_method():
    def rates(x, u):
        return x * 0, J @ u

    J = jnp.array([[0.3, -1.0], [2.0, 0.1]])
    for method in tm.TRANSFER_SCHEMES:
        _, u = tm._integrated(rates, jnp.zeros(2), jnp.eye(2), 0.1, method)
        np.testing.assert_allclose(u, tm.step_matrix(J, 0.1, method), rtol=0, atol=1e-15)


@pytest.fixture(scope="module")
def schemes():
    _, args = pendulum(0.5)
    start = zoo.friction_pendulum(beta=0.052, alpha=0.5, form="autonomous").x0
    cases = [("rk4", 500), ("rk4", 1000), ("euler", 1000)]
    return {case: tm.run(start, args, method=case[0], steps=case[1], periods=128, transient=20) for case in cases}


@pytest.mark.slow
def test_the_scheme_sticks_twice_a_period(schemes):
    assert all(run.sticks == 2 * 128 and run.crossings == 0 for run in schemes.values())


@pytest.mark.slow
@pytest.mark.parametrize("steps", [500, 1000])
def test_rk4_keeps_what_a_stick_destroys_at_any_step(schemes, steps):
    exponents = schemes["rk4", steps].exponents
    assert abs(exponents[0]) < 1e-12
    assert np.all(np.isfinite(exponents))
    assert abs(exponents[1] + exponents[2] - fu_checks.sum_of_the_scheme()) < 3e-4
    assert abs(exponents[1] + 0.028474432538) > 0.02  # the finite one is wrong too


@pytest.mark.slow
def test_euler_finds_the_finite_exponent_up_to_its_step(schemes):
    assert 5e-4 < abs(schemes["euler", 1000].exponents[1] + 0.028474432538) < 3e-3


def test_the_scheme_knows_its_methods():
    with pytest.raises(ValueError, match="euler"):
        tm.run(jnp.zeros(3), {}, method="rk5", steps=10, periods=1)


def test_the_parameters_and_bifurcations_are_those_of_the_reference():
    nonsmooth = json.loads((references.DATA / "nonsmooth.json").read_text())
    listed = {round(entry["beta"], 9) for entry in nonsmooth["bifurcations_alpha001"]}
    assert {round(beta, 9) for beta, _ in cases.BIFURCATIONS} == listed
    entries = {entry["id"]: entry for entry in nonsmooth["entries"]}
    for case in cases.CASES:
        parameters = entries[f"fu_fig{case.figure}"]["params"]
        assert (case.beta, case.alpha) == (parameters["beta"], parameters["alpha"])
    chaos = entries["fu_fig3"]
    assert (fu_checks.FINITE_PART, fu_checks.STICKS) == (chaos["lambda2_finite_part"], chaos["sticks_per_period"])
    with (references.DATA / "friction_beta_sweep.csv").open() as file:
        rows = {float(row["beta"]): row for row in csv.DictReader(file)}
    for beta, (label, exponent) in cases.SWEEP.items():
        assert rows[beta]["class_majority"] == label
        assert abs(float(rows[beta]["lambda_max_majority"]) - exponent) < 1e-9


@pytest.mark.slow
def test_cycles_are_those_of_the_reference():
    """The multipliers that the table shows, by the same call."""
    for case in cases.CASES[:2]:
        orbit = lh.floquet(*fu._problem(case), period=cases.PERIOD)
        exact = np.array(zoo.friction_pendulum(beta=case.beta, alpha=case.alpha).reference.exponents)
        assert fu_checks.near(np.asarray(orbit.exponents), exact, 1e-9)
        assert not fu_checks.near(np.asarray(orbit.exponents) + 1e-8, exact, 1e-9)
        assert np.max(np.abs(orbit.x0 - fu._problem(case)[1])) < 1e-9


def test_near_asks_for_minus_infinity_where_it_is():
    exact = np.array([-0.1, -np.inf])
    assert fu_checks.near(np.array([-0.1, -np.inf]), exact, 1e-9)
    assert not fu_checks.near(np.array([-0.1, -30.0]), exact, 1e-9)
    assert not fu_checks.near(np.array([-np.inf, -np.inf]), exact, 1e-9)


class Diagram:
    """As much of a diagram as the report asks for."""

    values = np.array([0.0, 0.1, 0.2, 0.3])
    labels = np.array([["chaos", "P3w0"], ["P1w0", "P1w0"], ["P1w0", "P2w1"], ["P2w1", "P1w0"]], object)
    lifetimes = np.array([[np.nan, 3.0], [0.0, 1.0], [5.0, 0.0], [2.0, 300.0]])


def test_outcomes_of_a_diagram():
    assert fu_report.outcomes(Diagram) == ["beside chaos", "one", "coexisting", "coexisting"]
    late = Diagram()
    late.lifetimes = Diagram.lifetimes + 200
    assert fu_report.outcomes(late)[0] == "transient"
    unsettled = Diagram()
    unsettled.labels = np.where(Diagram.labels == "chaos", "aperiodic/slow", Diagram.labels)
    assert fu_report.outcomes(unsettled)[0] == "undecided"
    assert fu_report._ranges([0.2, 0.3], Diagram) == "0.2–0.3"
    assert fu_report._ranges([0.0, 0.3], Diagram) == "0, 0.3"
    assert fu_report._ranges([], Diagram) == "none"


def test_what_json_cannot_hold_is_named():
    assert output.plain([1.0, -np.inf, np.nan]) == [1.0, "-inf", None]


@pytest.fixture(scope="module")
def vanishings():
    """One of each kind, and the two that are hardest to find: P1w3, and P5b of the list's lower precision."""
    wanted = ("fold of P1w3", "doubling of P1", "symmetry of P1", "fold of P3", "symmetry of P5b")
    system, _, args = fu._problem(cases.CASES[2])
    return fu_bifurcations.vanishings(system, args, [one for one in fu_bifurcations.LISTED if one.name in wanted])


@pytest.mark.slow
def test_the_largest_exponent_vanishes_at_bifurcations(vanishings):
    assert len(vanishings) == 6
    for one in vanishings:
        assert abs(one.zero - one.listed.beta) < (5e-10 if one.listed.error < 1e-8 else 1e-7), one.listed.name
        assert one.stable[1] < one.stable[0] < 0
        assert one.agrees
        assert (one.listed.kind == "fold") == np.isnan(one.beyond)


@pytest.mark.slow
def test_exponents_near_bifurcations_follow_the_law_of_their_kind(vanishings):
    for one in vanishings:
        law = 0.5 if one.listed.kind == "fold" else 1.0
        seen = np.log(one.stable[1] / one.stable[0]) / np.log(fu_bifurcations.SECOND_DISTANCE)
        assert abs(seen - law) < (0.2 if one.listed.cycle == "P1w3" else 0.05), one.listed.name


@pytest.mark.slow
def test_a_wrong_bifurcation_does_not_agree(vanishings):
    for one in vanishings:
        assert not dataclasses.replace(one, stable=tuple(-value for value in one.stable)).agrees
        assert not dataclasses.replace(one, stable=tuple(value - 1e-3 for value in one.stable)).agrees
        if one.listed.kind != "fold":
            assert not dataclasses.replace(one, beyond=-one.beyond).agrees


@pytest.fixture(scope="module")
def pair():
    return fu._pair()


@pytest.mark.slow
@pytest.mark.parametrize("case", cases.CASES[:2], ids=["slips", "sticks"])
def test_a_copy_follows_where_the_coupling_exceeds_the_exponent(pair, case):
    _, x0, args = fu._off(case)
    exact = zoo.friction_pendulum(beta=case.beta, alpha=case.alpha).reference.exponents[0]
    place = synchronisation.TrialStart(0.0, np.asarray(x0), np.ones(2))
    for _ in range(3):  # the first trials see how the motion settles
        _, place = synchronisation.trial(pair, place, args, -0.5, cases.PERIOD)
    for off, follows in ((-4e-3, False), (4e-3, True)):
        assert synchronisation.trial(pair, place, args, exact + off, cases.PERIOD)[0] == follows


@pytest.mark.slow
def test_a_copy_that_starts_near_goes_where_the_tangent_map_says(pair):
    """Two crossings per period, one copy soon after the other; 1e-10 apart rounding leaves five digits or so."""
    system, start, args = fu._off(cases.CASES[2])
    own = {"system": args, "coupling": jnp.asarray(0.0), "closer": jnp.asarray(1e-14), "farther": jnp.asarray(1e-2)}
    for x in np.asarray(lh.trajectory(system, start, args, t1=8 * cases.PERIOD, n=4).x):
        z = np.concatenate([x, x + 1e-10 * np.array([0.6, 0.8])])
        run = lh.trajectory(pair, z, own, t1=4 * cases.PERIOD, n=1)
        assert len(run.events) >= 8
        apart = np.asarray(run.x[-1, 2:] - run.x[-1, :2])
        exact = np.asarray(lh.tangent_map(system, x, args, t1=4 * cases.PERIOD).matrix) @ (z[2:] - z[:2])
        assert np.linalg.norm(apart - exact) < 5e-3 * np.linalg.norm(exact)


@pytest.mark.slow
@pytest.mark.parametrize("start", [1e-6, 1e-8])
def test_in_chaos_the_coupling_is_the_exponent_however_near_the_copies_start(start, monkeypatch):
    monkeypatch.setattr(synchronisation, "START_DISTANCE", start)
    found = fu._synchronised(cases.CASES[2], 100)
    exact = zoo.friction_pendulum(beta=0.052, alpha=0.01).reference.exponents[0]
    assert found.error < 2.5e-3
    assert abs(found.exponent - exact) < 3 * found.error


def test_distances_that_guards_take_for_rounding_are_refused(pair, monkeypatch):
    """At 1e-12 a trial would end where one copy crosses before the other, while they are 200 times too far apart."""
    monkeypatch.setattr(synchronisation, "START_DISTANCE", 1e-12)
    _, x0, args = fu._off(cases.CASES[2])
    with pytest.raises(ValueError, match="cannot tell smaller distances"):
        synchronisation.trial(pair, synchronisation.TrialStart(0.0, np.asarray(x0), np.ones(2)), args, 0.1, 1.0)


def test_the_coupling_at_which_half_of_the_trials_follow():
    """Exact logistic parts: the midpoint; the error falls as the root of the number of trials."""
    d = np.array([0.0, 0.5, 0.25, 0.125, 0.0625, 0.09375, 0.109375])
    p = 1 / (1 + np.exp(-70 * (d - 0.12)))
    middle, error = synchronisation.midpoint(d, p, 30)
    assert abs(middle - 0.12) < 1e-9
    assert abs(synchronisation.midpoint(d, p, 120)[1] - error / 2) < 1e-9
    drawn = np.random.default_rng(1).binomial(400, p, size=(200, len(d))) / 400
    middles = [synchronisation.midpoint(d, one, 400)[0] for one in drawn]
    assert abs(np.std(middles) / synchronisation.midpoint(d, p, 400)[1] - 1) < 0.2


@pytest.mark.parametrize("trials", [2, 29])
def test_too_few_trials_in_chaos_are_refused(pair, trials):
    _, x0, args = fu._off(cases.CASES[2])
    with pytest.raises(ValueError, match=f"at least 30 .* too small.*got {trials}"):
        synchronisation.synchronised(pair, np.asarray(x0), args, period=1.0, angles=(0,), trials=trials, steps=3)


def bisections(trials: int, steepness: float, repetitions: int):
    """The limit d₀ of each repetition, drawn anew, and what bisection finds of trials that follow a logistic law."""
    rng = np.random.default_rng(3)
    for limit in rng.uniform(0.05, 0.3, repetitions):

        def following(d, limit=limit):
            return int(rng.binomial(trials, expit(steepness * (d - limit))))

        yield limit, synchronisation.bisected(following, trials, cases.CHAOS_STEPS)


@pytest.mark.slow
@pytest.mark.parametrize("steepness", [20.0, 70.0, 300.0])
@pytest.mark.parametrize("trials", [30, 100])
def test_errors_of_the_midpoint_hold_it_as_often_as_they_say(trials, steepness):
    """Of repetitions, couplings chosen by bisection, that of a Gaussian: 68 and 95 %."""
    off = np.array([abs(found.exponent - limit) / found.error for limit, found in bisections(trials, steepness, 600)])
    assert 0.60 < np.mean(off < 1) < 0.75
    assert 0.90 < np.mean(off < 2) < 0.98


def test_where_all_trials_end_alike_the_midpoint_lies_between():
    """A law far steeper than the bisection is fine: half the width of its last interval, whatever the trials."""
    for trials in (1, 2, 30):
        for limit, found in bisections(trials, 1e9, 50):
            assert found.error == 2.0**-cases.CHAOS_STEPS
            assert abs(found.exponent - limit) <= found.error
    # Where one coupling is at the limit itself, between its neighbours.
    assert synchronisation.midpoint([0.0, 0.5, 0.25, 0.125], [0, 1, 1, 0.5], 2) == (0.125, 0.125)


def test_the_copy_is_pulled_as_the_formula_says(pair):
    """Both slip in the same direction: the second has d (x − y) more."""
    _, _, args = fu._problem(cases.CASES[2])
    z = jnp.array([0.3, 0.5, -0.2, 0.7])
    own = {"system": args, "coupling": jnp.asarray(0.25), "closer": jnp.asarray(1e-9), "farther": jnp.asarray(1.0)}
    system = fu._problem(cases.CASES[2])[0]
    field = np.concatenate([np.asarray(system.fields[0](1.0, x, args)) for x in (z[:2], z[2:])])
    field[2:] += 0.25 * np.asarray(z[:2] - z[2:])
    np.testing.assert_allclose(pair.fields[0](jnp.asarray(1.0), z, own), field, rtol=0, atol=1e-15)
    assert pair.mode_names[0] == "plus/plus"
    assert len(pair.mode_names) == 9


def test_exponents_are_numbered_alike_everywhere():
    """λ1 ≥ λ2 ≥ λ3 of (θ, θ', z): the 0 of z = t is the first of a cycle and the second in chaos."""
    for case, order in zip(cases.CASES, ([0, 1, 2], [0, 1, 2], [1, 0, 2]), strict=True):
        found = object.__new__(fu.FigureResults)
        object.__setattr__(found, "case", case)
        assert found.order == order
        assert case.says[order.index(0)] == "zero"


def test_running_exponents_are_numbered_like_the_final_ones():
    """Columns that change their places at a loss, and one that is lost: λ1 ≥ λ2 ≥ λ3, what is lost last."""

    class History:
        time = np.array([1.0, 2.0, 3.0])
        exponents = np.array([[0.1, -0.2, 0.0], [0.1, -0.2, 0.0], [0.1, 0.0, 0.3]])
        growth = np.diff(exponents * time[:, None], axis=0, prepend=0.0)
        losses = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1]])

    time, running, lost = fu_figures.ordered(History)
    np.testing.assert_array_equal(time, History.time)
    np.testing.assert_allclose(running, [[0.1, 0.0, -0.2], [0.1, 0.0, -0.2], [0.1, 0.0, 0.3]], atol=1e-15)
    np.testing.assert_array_equal(lost, [[False] * 3, [False] * 3, [False, False, True]])


def test_signs_of_cycles_are_counted_where_the_points_say_so():
    class Signs:
        labels = np.array([["P1w0", "chaos"], ["P2w0", "aperiodic/slow"]], object)
        exponents = np.array([[[-0.1], [0.1]], [[0.2], [0.3]]])
        stderr = np.full((2, 2, 1), 1e-3)

    assert fu_checks.signs_on_cycles(Signs) == (2, 1)


def test_the_diagram_has_as_many_values_in_quick_mode():
    """With 61 values the chaotic ranges of Fig. 4 were stripes."""
    assert cases.QUICK.values == cases.FULL.values >= 301


def test_the_starts_lie_beside_the_cycles():
    for case in cases.CASES[:2]:
        assert np.max(np.abs(fu._off(case)[1] - fu._problem(case)[1])) > 0.1


def test_claims_end_with_their_outcome():
    made = [
        claims.Claim("Fig. 1", "one", "one", claims.AGREED),
        claims.Claim("Fig. 2", "one", "two", claims.CORRECTED, "it is even"),
        claims.Claim("Fig. 3", "fast", "slow", claims.NOT_REPRODUCIBLE, "no time is told"),
    ]
    assert claims.claim_lines(made) == [
        "agreed: 1 of 3 claims of the paper",
        "  Fig. 1. Paper: one. Here: one.",
        "corrected: 1 of 3 claims of the paper",
        "  Fig. 2. Paper: one. Here: two.",
        "    evidence: it is even.",
        "not reproducible: 1 of 3 claims of the paper",
        "  Fig. 3. Paper: fast. Here: slow.",
        "    reason: no time is told.",
    ]
    with pytest.raises(ValueError, match="evidence or reason"):
        claims.Claim("Fig. 2", "one", "two", claims.CORRECTED)
    with pytest.raises(ValueError, match="outcome"):
        claims.Claim("Fig. 2", "one", "two", "perhaps", "who knows")
    lines = claims.check_lines([claims.Check("λ1", "0.1", "0.2", False), claims.Check("λ2", "−∞", "−∞", True)])
    assert [line.split() for line in lines] == [
        ["check", "wanted", "found", "agree"],
        ["λ1", "0.1", "0.2", "NO"],
        ["λ2", "−∞", "−∞", "yes"],
    ]


@pytest.mark.parametrize("passed", [True, False])
def test_the_command_line_finds_the_paper(passed, tmp_path, capsys, monkeypatch):
    class Stub(str):
        def __init__(self, _):
            self.passed = passed

    asked = {}
    monkeypatch.setattr(fu, "reproduce", lambda **keywords: asked.update(keywords) or Stub("the table"))
    monkeypatch.setattr(fu, "write", lambda result, out: [out / "fu.json"])
    assert main(["papers", "fu", "--quick", "--out", str(tmp_path)]) == (0 if passed else 1)
    assert asked == {"quick": True, "progress": None}
    assert capsys.readouterr().out.splitlines() == ["the table", f"wrote {tmp_path / 'fu.json'}"]


@pytest.mark.slow
def test_the_figures_by_the_command_line(tmp_path, capsys):
    assert main(["papers", "fu", "--quick", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "passed: all" in out
    names = [f"fu-{number}.{kind}" for number in (1, 2, 3, 4) for kind in ("png", "pdf")]
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*names, "fu.json"])
    data = json.loads((tmp_path / "fu.json").read_text())
    assert data["passed"]
    assert all(data["checks"].values())
    assert {one["outcome"] for one in data["claims"]} == {"agreed", "corrected", "not reproducible"}
    assert all(abs(one["zero_of_exponent"] - one["beta"]) < 1e-7 for one in data["bifurcations"])
    assert len(data["bifurcations"]) == 15
    assert len(data["fig_4"]["beta"]) == 301
    assert data["figures"][1]["ours"]["exponents"][1] == "-inf"
    assert abs(data["figures"][0]["cycle"]["exponents"][0] + 0.152604511216) < 1e-9
