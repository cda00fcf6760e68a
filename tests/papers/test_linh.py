"""Linh, Truong & Tuyen: the published tables, what the reproduction computes, what its checks see, its figures."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid.__main__ import main
from lyaphybrid.papers.claims import AGREED, CORRECTED, NOT_REPRODUCIBLE
from lyaphybrid.papers.linh import claims as linh_claims
from lyaphybrid.papers.linh import intervals as linh_intervals
from lyaphybrid.papers.linh import orders as linh_orders
from lyaphybrid.papers.linh import report as linh_report
from lyaphybrid.papers.linh import reproduction as linh
from lyaphybrid.papers.linh import tables
from lyaphybrid.papers.linh import theory as linh_theory
from lyaphybrid.papers.linh.beyond import extensions as linh_extensions
from lyaphybrid.papers.reproductions import computed

# By an independent program in more digits: λ_i(T) with ln R(t₀)_ii counted, and without.
EXACT = {
    ("discrete", 1000): (-0.17902229993970464, -2.8205072083878955),
    ("discrete", 10000): (-0.17731414001490464, -2.8226388108178555),
    ("continuous", 5000): (-0.17766487935336464, -2.8224391224590555),
}


def test_the_published_tables():
    assert len(tables.PUBLISHED) == 90
    for table in tables.TABLES:
        rows = [row for row in tables.PUBLISHED if row.table == table]
        assert [(row.tolerance, row.length) for row in rows] == [
            (tolerance, length) for tolerance in (1e-4, 1e-5, 1e-6) for length in (1000, 5000, 10000)
        ]
    values = {(row.table.number, row.length, row.tolerance): row for row in tables.PUBLISHED}
    first, seventh, last = values[1, 1000, 1e-4], values[7, 5000, 1e-5], values[10, 10000, 1e-6]
    assert (first.exponents, first.steps, first.seconds) == ((-0.17903157, -2.82030775), 4580, 0.558963)
    assert (seventh.exponents, seventh.steps, seventh.seconds) == ((-0.17765247, -2.82245862), 15627, 5.089826)
    assert (last.exponents, last.steps, last.seconds) == ((-0.17731420, -2.82264204), 92890, 34.767049)
    # All are near the exact values, the steps nearly proportional to T: no digit is lost.
    for row in tables.PUBLISHED:
        assert_allclose(row.exponents, row.exact, rtol=0, atol=6e-3)
        short = values[row.table.number, 1000, row.tolerance]
        assert_allclose(row.steps / row.length, short.steps / 1000, rtol=0.05)


@pytest.mark.parametrize(("algorithm", "length"), list(EXACT))
def test_exact_values(algorithm, length):
    assert_allclose(tables.exact(algorithm, length), EXACT[algorithm, length], rtol=0, atol=1e-12)


def test_sums_of_the_offsets():
    """The trace is −3, so Σ s_i(T) = −3T + what volumes at both ends contribute."""
    assert_allclose(sum(tables.OFFSETS["discrete"]), 0.5 * np.log(2.5625), atol=1e-9)
    assert_allclose(sum(tables.OFFSETS["continuous"]), 0.5 * np.log(2.5625 / 7.25), atol=1e-9)


def test_methods_of_the_tables():
    kinds = [type(table.method(1e-5)) for table in tables.TABLES]
    discrete, continuous, implicit = lh.HalfExplicit, lh.ContinuousQR, lh.ESDIRK
    assert kinds == [discrete, continuous, *[implicit] * 2, *[discrete] * 2, *[continuous] * 2, *[implicit] * 2]
    assert [tables.TABLES[i].method(1e-5).tableau for i in (2, 3, 8, 9)] == ["esdirk34", "esdirk54b"] * 2


@pytest.mark.slow
@pytest.mark.parametrize(("example", "fewest", "most"), [("5.1", 4.5, 5.3), ("5.2", 2.7, 3.3)])
def test_the_method_without_the_reformulation(example, fewest, most):
    """It keeps its order where E is constant, and loses two where it is not."""
    ends, exact = linh_orders.end(example, "unreformulated", (32, 64)), linh_orders.end(example, "exact", (400,))
    errors = np.max(np.abs(ends - exact), axis=1)
    assert fewest < np.log2(errors[0] / errors[1]) < most


@pytest.mark.slow
def test_the_method_without_the_reformulation_stays_on_the_constraints():
    system, x0, args = tables.problem_of("5.2")
    t, h = jnp.asarray(0.0), jnp.asarray(0.1)
    x = jax.jit(lambda x: linh_orders.unreformulated(system.field, args, t, x, h))(x0)
    assert float(jnp.max(jnp.abs(system.field.constraint(t + h, x, args)))) < 1e-13


@pytest.mark.slow
def test_the_ordinary_equation_is_the_same_motion():
    system, x0, args = tables.problem_of("5.1")
    args = args | {"mass": jnp.asarray(1.7), "damping": jnp.asarray(0.6), "radius": jnp.asarray(1.4)}
    x = lh.consistent_start(system, x0, args)
    assert_allclose(linh.spring(0.0, x[:2], args), system.field(jnp.asarray(0.0), x, args)[:2], rtol=1e-12)


@pytest.mark.slow
def test_steps_are_counted():
    """By time: the run of twice the length has twice the steps, and the ends of halves are among them."""
    method = lh.HalfExplicit(rtol=1e-4)
    short, long = (linh._steps("5.1", method, length) for length in (100.0, 200.0))
    assert abs(long - 2 * short) < 0.05 * long
    assert abs(short / 458 - 1) < 0.05  # of 4580 for 1000


# A reproduction made by hand, in which all laws hold, and what each check says where one is broken.


def by_hand_row(row):
    high = 1.8 if row.table.algorithm == "continuous" else 1.02
    bounds = linh_intervals.wanted(row)
    if row.table.pair == "ESDIRK54b":
        return linh.RowResults(np.array(row.exponents), row.steps, 0.01, bounds)
    as_in_table_9 = np.array(row.exponents) - row.exact if row.table.number == 9 else row.tolerance
    return linh.RowResults(row.exact + as_in_table_9, round(high * row.steps), 0.01, bounds)


def characteristic_by_hand():
    exponents = tables.limits() + np.array([-1.77, 2.24]) / np.array(linh_theory.LENGTHS)[:, None]
    return linh_theory.Characteristic(exponents, np.stack([np.eye(2)] * len(linh_theory.LENGTHS)))


def extensions_by_hand():
    tolerances, both = np.array(tables.OF_TABLES), linh_extensions.BOTH
    errors, size = 2 * tolerances[:, None] * np.ones(2), tables.limits() - tables.exact("continuous", 1000)
    grid = np.linspace(0.3, -0.6, 40)
    return linh_extensions.Extensions(
        dict.fromkeys(both, errors),
        dict.fromkeys(both, errors),
        dict.fromkeys(both, np.stack([tables.exact("continuous", 1000), np.abs(size)])),
        dict.fromkeys(both, np.stack([errors, 10 * errors], axis=1)),
        np.append(tables.limits(), linh_extensions.OF_IMPLICIT),
        linh_extensions.Large(220, 40, grid + 1e-8, grid),
    )


@functools.cache
def by_hand() -> linh.Reproduction:
    tolerances, time = np.array(tables.TOLERANCES), np.geomspace(1.0, 1000.0, 91)
    eighth = [row.exponents for row in tables.PUBLISHED if row.table.number == 8 and row.length == 1000]
    unlike = np.tile(tables.exact("continuous", 1000), (3, 1))
    powers = {"propagated": 5, "embedded": 4, "without (9)": 3, "without (9), constant E": 5}
    apart = np.subtract(tables.OFFSETS["discrete"], tables.OFFSETS["continuous"])
    start = np.array([1.0, -1.0]) / 1000
    return linh.Reproduction(
        linh.FULL,
        tuple(by_hand_row(row) for row in tables.PUBLISHED),
        {
            (example, name): 2 * tolerances[:, None] * np.ones(2)
            for example in tables.EXAMPLES
            for name in tables.OFFSETS
        },
        {"5.1": unlike, "5.2": unlike, "5.2 fast": np.array(eighth)},
        {name: (time, tables.exact(name, time) + np.exp(-time)[:, None]) for name in tables.OFFSETS},
        tuple(linh.Ordinary(tol, 1000.0, tables.limits() + start, 0.01, 0.02, 0.03) for tol in tables.OF_TABLES),
        linh.Linearisation(2 * tolerances, tolerances, 8.0 + 0 * tolerances),
        {name: np.array(linh_orders.COUNTS, float) ** -p for name, p in powers.items()},
        {name: np.array(linh_orders.COUNTS, float) ** -p for name, (*_, p) in linh_orders.EXPONENT_ORDERS.items()},
        apart,
        np.array([-0.179, -0.19]),
        characteristic_by_hand(),
        linh_theory.Turning(np.full((7, 19), 1.5), np.ones((7, 19)), np.ones((7, 19))),
        linh_theory.Perturbed(*[tables.limits() + np.array(linh_theory.SIZES)[:, None]] * 3),
        extensions_by_hand(),
    )


def failures(found):
    return [one.name for one in found.checks if not one.holds]


def test_the_checks_hold_where_the_laws_do():
    found = by_hand()
    assert found.passed, failures(found)
    assert "passed: all" in str(found)
    assert "Those of\n     Tables 2 and 7 are not explained by it" in str(found)
    for number in range(1, 11):
        assert f"Table {number}:" in str(found)
    assert "What the paper names and does not compute." in str(found)


def in_table(number, **changes):
    """One row of the table, the second, is another."""

    def broken(r):
        at = [i for i, row in enumerate(r.rows) if row.table.number == number][1]
        found = list(r.found)
        changed = {name: change(getattr(found[at], name)) for name, change in changes.items()}
        found[at] = dataclasses.replace(found[at], **changed)
        return dataclasses.replace(r, found=tuple(found))

    return broken


def in_part(name, new):
    return lambda r: dataclasses.replace(r, **{name: new(getattr(r, name))})


def in_dict(name, key, new):
    return in_part(name, lambda old: old | {key: new(old[key])})


def as_in_table(number):
    """The published exponents with T = 1000."""
    rows = [row.exponents for row in tables.PUBLISHED if row.table.number == number and row.length == 1000]
    return lambda _: np.array(rows)


def bounds_off(found):
    return dataclasses.replace(found, upper=found.upper + 151e-4)


def steklov_off(found):
    return dataclasses.replace(found, steklov=found.steklov - 0.02)


def theory(part, **changes):
    return in_part(
        part, lambda found: dataclasses.replace(found, **{k: f(getattr(found, k)) for k, f in changes.items()})
    )


def with_order(power):
    return lambda errors: np.array(linh_orders.COUNTS, float) ** -power


def ordinary(**changes):
    return in_part("ordinary", lambda runs: (*runs[:2], dataclasses.replace(runs[2], **changes)))


def linearised(**changes):
    return in_part("linearisation", lambda found: dataclasses.replace(found, **changes))


def extended(**changes):
    return theory("extensions", **changes)


def of_both(change):
    return lambda runs: {example: change(found) for example, found in runs.items()}


def of_second(change):
    return lambda runs: runs | {"5.2": change(runs["5.2"])}


BROKEN = [
    *(
        (extended(**{part: of_both(lambda errors: 6 * errors)}), f"{tables.EXAMPLES[example]}, {name}: errors")
        for part, name in (("collocation", "Radau IIA"), ("continuous_esdirk", "continuous, ESDIRK54b"))
        for example in linh_extensions.BOTH
    ),
    (extended(svd=of_both(lambda found: found * [[1.0], [0.5]])), "SVD method: |λ(T)"),
    (extended(svd=of_both(lambda found: found + [[1e-5, 0.0], [0.0, 0.0]])), "SVD method: its exponents have the sum"),
    (extended(svd=of_second(lambda found: found + [[1e-6, -1e-6], [0, 0]])), "SVD method: Examples 5.1 and 5.2"),
    (extended(bounds=of_second(lambda found: found * [[[11.0], [1.0]]])), "§4.1: errors over"),
    (extended(bounds=of_second(lambda found: found * [[[1.0], [3.0]]])), "§4.1: bounds over"),
    (extended(implicit=lambda values: values + [0, 0, 1e-6]), "F(t, x, x') = 0"),
    (extended(large=lambda grid: dataclasses.replace(grid, found=grid.found + 1e-5)), "a power grid"),
    *((in_table(n, exponents=lambda v: v + 31e-4), f"Table {n}: errors") for n in range(1, 11)),
    *((in_table(n, steps=lambda v: 5 * v), f"Table {n}: 0.8 to") for n in range(1, 11)),
    *((in_table(n, steps=lambda v: v // 3), f"Table {n}: 0.8 to") for n in range(1, 11)),
    *((in_table(n, intervals=bounds_off), f"Table {n}: λ^l and λ^u") for n in range(1, 11)),
    *((in_table(n, intervals=steklov_off), f"Table {n}: Steklov") for n in range(1, 11)),
    (theory("characteristic", exponents=lambda e: e + 1e-6), "Λ: T (ln μ_i"),
    (theory("characteristic", vectors=lambda p: p + 1e-6 * np.arange(4)[:, None, None]), "Λ: its eigenvectors"),
    (theory("turning", difference=lambda d: 2 * d), "|ΔA| / (M δ + N ε)"),
    (theory("turning", difference=lambda d: d / 2), "M δ is needed"),
    (theory("perturbed", constant=lambda e: e + 1e-7), "those of the pencil"),
    (theory("perturbed", periodic=lambda e: e + 1e-3), "Definition 2.3: exponents move"),
    (in_part("state_alone", lambda v: v - [0, 2.6]), "control of x alone"),
    (in_dict("exponent_orders", "continuous, right rectangle", with_order(3)), "is of first order"),
    *(
        (in_dict("exponent_orders", name, with_order(p - 1)), f"exponents O(h^{p}): {name}")
        for name, (*_, p) in linh_orders.EXPONENT_ORDERS.items()
    ),
    *((in_table(n, steps=lambda v: round(1.04 * v)), "Tables 4 and 10: errors") for n in (4, 10)),
    (in_table(9, exponents=lambda v: v + 3e-5), "Table 9: the weights"),
    *(
        (in_dict("accuracy", (example, name), lambda e: e + 1e-8), f"{tables.EXAMPLES[example]}, {name}: errors")
        for example in tables.EXAMPLES
        for name in tables.OFFSETS
    ),
    (in_part("initial", lambda v: v + 1e-6), "the two algorithms"),
    (in_dict("rectangle", "5.2 fast", lambda v: v + 1e-4), "rule leaves of the errors of Table 8"),
    *(
        (in_dict("rectangle", example, as_in_table(n)), "… and does of those")
        for n, example in ((2, "5.1"), (7, "5.2"))
    ),
    (in_dict("running", "discrete", lambda run: (run[0], run[1] + 1e-6)), "discrete: λ(t)"),
    (in_dict("running", "continuous", lambda run: (run[0], run[1] * (1 + 1e-6))), "continuous: λ(t)"),
    (ordinary(exponents=np.array([-0.1, -2.9])), "same exponents in the limit"),
    (ordinary(exponents=np.array([-0.177, -2.822])), "sum is −3"),
    (linearised(difference=np.array(tables.TOLERANCES) ** 0.5), "in proportion"),
    (linearised(bound=0.1 * np.ones(7)), "the bound N ε"),
    (in_dict("orders", "propagated", with_order(4)), "order 5: propagated"),
    (in_dict("orders", "embedded", with_order(5)), "order 4: embedded"),
    (in_dict("orders", "without (9)", with_order(5)), "order is lost"),
    (in_dict("orders", "without (9), constant E", with_order(3)), "order 5: without (9), constant E"),
]


@pytest.mark.parametrize(("broken", "says"), BROKEN, ids=[f"{i} {says}" for i, (_, says) in enumerate(BROKEN)])
def test_each_check_sees_its_law_broken(broken, says):
    found = broken(by_hand())
    failed = failures(found)
    assert any(says in name for name in failed), failed
    assert not found.passed
    assert "FAILED" in str(found)


def test_every_check_is_broken_once():
    says = [one for _, one in BROKEN]
    assert all(any(one in name for one in says) for name in [one.name for one in by_hand().checks])


def test_what_is_no_number_fails():
    for broken in (
        in_table(1, exponents=lambda v: v * np.nan),
        in_dict("accuracy", ("5.1", "discrete"), lambda e: e * np.nan),
        in_dict("orders", "without (9)", lambda e: e * np.nan),
        in_dict("rectangle", "5.2 fast", lambda v: v * np.nan),
    ):
        assert not broken(by_hand()).passed


@pytest.mark.slow
def test_a_small_grid():
    """Six rows of buses: the same as the matrix exponential of the equations reduced by sparse factors."""
    found = linh_extensions.large(length=6)
    assert (found.n, found.d) == (22, 4)
    assert_allclose(found.found, found.exact, rtol=0, atol=1e-7)


def test_figures_show_what_was_computed():
    found = by_hand()
    for name, panels in {"errors": 2, "orders": 1, "convergence": 2, "linearisation": 1}.items():
        axes = found.figure(name).axes
        assert len(axes) == panels
        assert all(ax.get_lines() for ax in axes)
    line = found.figure("errors").axes[0].get_lines()[0]
    assert_allclose(line.get_ydata(), 2.0)
    line = found.figure("convergence").axes[1].get_lines()[0]
    assert_allclose(line.get_ydata()[-1], tables.OFFSETS["discrete"][1] / 1000)
    with pytest.raises(ValueError, match="errors, orders"):
        found.figure("speed")


def test_numbers_are_json():
    data = json.loads(json.dumps(linh_report.numbers(by_hand()), allow_nan=False))
    assert data["passed"]
    assert len(data["tables"]) == 90
    assert data["tables"][0]["in_the_paper"]["steps"] == 4580
    assert_allclose(data["orders"]["slopes"]["without (9)"], 3)


def test_tasks_are_done_program_by_program():
    fractions = []
    tasks = {"a": ("one", abs, -3), "b": ("two", abs, 4), "c": ("one", max, 1, 2)}
    assert computed(tasks, fractions.append) == {"a": 3, "b": 4, "c": 2}
    assert sorted(fractions)[-1] == 1.0
    assert len(fractions) == 3


def test_published_errors_of_table_9_are_those_of_order_4():
    assert abs(linh_claims._power_of_steps(by_hand(), 9) - 4) < 0.1


def test_claims_end_in_one_of_three_ways():
    found = by_hand()
    outcomes = {one.item: one.outcome for one in found.claims}
    assert outcomes["Table 8"] == CORRECTED
    assert outcomes["Tables 2 and 7"] == NOT_REPRODUCIBLE
    assert outcomes["Theorem 4.1"] == AGREED
    for outcome in (AGREED, CORRECTED, NOT_REPRODUCIBLE):
        assert f"{outcome}: {sum(one.outcome == outcome for one in found.claims)} of" in str(found)
    text = str(found)
    assert text.index("check  ") < text.index(f"{AGREED}: ") < text.index(f"{CORRECTED}: ")


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2])
def test_bounds_and_steklov_differences(number):
    """λ(t) = λ + C/t, known to 1e-9; the first window holds C, but for a motion that is not quite at rest there."""
    [row] = [row for row in tables.PUBLISHED if (row.table.number, row.length, row.tolerance) == (number, 1000, 1e-6)]
    found, wanted = linh_intervals.intervals(row), linh_intervals.wanted(row)
    assert_allclose(found.lower, wanted.lower, rtol=0, atol=1e-5)
    assert_allclose(found.upper, wanted.upper, rtol=0, atol=1e-5)
    assert np.all(found.upper - found.lower > 1e-3)
    assert_allclose(found.steklov, wanted.steklov, rtol=0, atol=1e-3)


@pytest.mark.slow
def test_the_matrix_whose_eigenvalues_are_the_exponents():
    """Beside the singular value decomposition of Y itself, as long as its condition number leaves digits."""
    found = linh_theory.characteristic((5, 10))
    system, x0, args = tables.problem_of("5.1")
    start = np.array([[1, 0], [0, 1], [0, 0.5], [2, -1]])  # the columns of Ē⁻¹ where x₁ = 1
    for i, length in enumerate((5.0, 10.0)):
        method = lh.HalfExplicit(rtol=1e-13, tableau="dopri8")
        y = np.asarray(lh.tangent_map(system, x0, args, t1=length, method=method).matrix) @ start
        _, sizes, vectors = np.linalg.svd(y, full_matrices=False)
        assert_allclose(found.exponents[i], np.log(sizes) / length, atol=1e-6)
        assert_allclose(np.abs(found.vectors[i]), np.abs(vectors.T), atol=1e-7)
        growth = np.log(np.linalg.norm(y @ found.vectors[i], axis=0)) / length
        assert_allclose(growth, found.exponents[i], atol=1e-5)


@pytest.mark.slow
def test_perturbed_equations():
    """Constant ones: eigenvalues; smaller ones move the exponents less; periodic ones of zero mean move them less."""
    found = linh_theory.perturbed()
    assert_allclose(found.constant, found.eigenvalues, rtol=0, atol=1e-8)
    away = np.abs(found.constant - tables.limits())
    assert np.all(away[:-1] > 5 * away[1:])
    assert np.all(away[-1] < 1e-4)
    assert np.all(np.abs(found.periodic - tables.limits()) < away)


def test_the_pencil_of_the_unperturbed_system():
    assert_allclose(linh_theory.pencil(0.0), tables.limits(), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", linh_orders.EXPONENT_ORDERS)
def test_exponents_have_the_order_of_the_method(name):
    example, method, p = linh_orders.EXPONENT_ORDERS[name]
    exact = linh_orders.exponents_at_end(example, lh.HalfExplicit(rtol=1e-14, tableau="dopri8"), (400,))
    errors = np.max(np.abs(linh_orders.exponents_at_end(example, method, (16, 32, 64)) - exact), axis=1)
    slope = np.log2(errors[0] / errors[2]) / 2
    print(name, errors, slope)
    # The continuous algorithm has errors of order 6 that are still larger with these steps.
    assert p - 0.4 < slope < (6.6 if name.startswith("continuous") and p == 5 else p + 0.4)


@pytest.mark.slow
def test_the_tables_by_the_command_line(tmp_path, capsys):
    assert main(["papers", "linh", "--quick", "--out", str(tmp_path)]) == 0
    assert "passed: all" in capsys.readouterr().out
    names = [f"linh-{name}.{kind}" for name in linh.FIGURES for kind in ("png", "pdf")]
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*names, "linh.json"])
    data = json.loads((tmp_path / "linh.json").read_text())
    assert data["passed"]
    assert all(data["checks"].values())
    assert {row["T"] for row in data["tables"]} == {1000}
    for row in data["tables"]:  # with φ controlled the errors of the continuous algorithm are smaller, row by row
        if row["algorithm"] == "continuous":
            ours, paper = (np.subtract(row[who]["exponents"], row["exact"]) for who in ("ours", "in_the_paper"))
            assert np.max(np.abs(ours)) < 0.8 * np.max(np.abs(paper))
