"""Coefficients of diagonally implicit methods: order conditions, stability, which member of a family a paper used."""

import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

from lyaphybrid.integrators.implicit.implicit_tableaux import IMPLICIT
from lyaphybrid.papers.linh import tables as linh_tables

ORDERS = {"esdirk34": (4, 3), "esdirk54b": (5, 4), "kvaerno3": (3, 2), "kvaerno4": (4, 3), "kvaerno5": (5, 4)}


def square(name):
    """A (s, s), the weights that a step goes on by, the embedded ones, and c."""
    table = IMPLICIT[name]
    a = np.zeros((len(table.a) + 1,) * 2)
    for i, row in enumerate(table.a, start=1):
        a[i, : len(row)], a[i, i] = row, table.diagonal
    return a, np.asarray(table.b), np.asarray(table.b) - table.errors[0], np.array([0.0, *table.c])


def trees(order):
    """The rooted trees of this order, each the tuple of its branches."""
    if order == 1:
        return [()]
    made = set()

    def fill(left, largest, branches):
        if left == 0:
            made.add(tuple(sorted(branches)))
        for size in range(min(left, largest), 0, -1):
            for branch in trees(size):
                fill(left - size, size, [*branches, branch])

    fill(order - 1, order - 1, [])
    return sorted(made)


def nodes(tree):
    return 1 + sum(nodes(branch) for branch in tree)


def density(tree):
    return nodes(tree) * int(np.prod([density(branch) for branch in tree]))


def elementary(tree, a):
    return np.prod([np.ones(len(a)), *(a @ elementary(branch, a) for branch in tree)], axis=0)


def test_there_are_as_many_trees_as_there_should_be():
    assert [len(trees(order)) for order in range(1, 7)] == [1, 1, 2, 4, 9, 20]
    assert sorted(density(tree) for tree in trees(4)) == [4, 8, 12, 24]


@pytest.mark.parametrize("name", IMPLICIT)
def test_order_conditions(name):
    """Both members of the pair have their order; and the embedded one no more, else there is no estimate."""
    a, b, embedded, c = square(name)
    assert_allclose(a.sum(axis=1), c, atol=1e-8 if name in ("kvaerno3", "kvaerno4") else 1e-14)
    accuracy = 1e-8 if name in ("kvaerno3", "kvaerno4") else 1e-13
    for weights, order in zip((b, embedded), ORDERS[name], strict=True):
        for p in range(1, order + 1):
            for tree in trees(p):
                assert abs(weights @ elementary(tree, a) - 1 / density(tree)) < accuracy, (order, tree)
        beyond = [abs(weights @ elementary(tree, a) - 1 / density(tree)) for tree in trees(order + 1)]
        assert max(beyond) > 1e-4


def stability(a, b, z):
    return 1 + z * (b @ np.linalg.solve(np.eye(len(b)) - z * a, np.ones(len(b))))


def test_stability_of_esdirk54b():
    """Both members are A-stable (no pole is on the left, so the imaginary axis tells), the embedded one is L-stable."""
    a, b, embedded, _ = square("esdirk54b")
    axis = 1j * np.geomspace(1e-2, 1e4, 2000)
    for weights in (b, embedded):
        assert max(abs(stability(a, weights, z)) for z in axis) < 1 + 1e-12
    assert abs(stability(a, embedded, -1e8)) < 1e-6
    assert_allclose(stability(a, b, -1e8), 0.8732, atol=1e-4)


# ESDIRK54b: the family, and its member that the paper used.


def family(gamma, c4, c5, a52):
    """A (7, 7): stages from the third on of order 3, the sixth of order 4, the last with the quadrature of order 5."""
    a = np.diag([0.0, *[gamma] * 6])
    c = np.array([0.0, 2 * gamma, (3 + np.sqrt(3)) * gamma, c4, c5, 1.0, 1.0])
    a[4, 1] = a52
    # Which entries Σ a_ij c_j^k = c_i^(k+1)/(k+1), k = 1, 2, …, determine.
    for i, columns in enumerate(([0], [1], [1, 2], [2, 3], [2, 3, 4], [2, 3, 4, 5]), start=1):
        powers = np.arange(1, len(columns) + 1) if i > 1 else np.array([], int)
        known = a[i] @ c[:, None] ** powers
        if i > 1:
            of_columns = c[columns][None, :] ** powers[:, None]
            a[i, columns] = np.linalg.solve(of_columns, c[i] ** (powers + 1) / (powers + 1) - known)
        a[i, 0] = c[i] - a[i, 1:].sum()
    return a, c


def at_infinity(a, last):
    """R(∞) of the method whose weights are this row."""
    return -np.linalg.solve(a[1 : last + 1, 1 : last + 1], a[1 : last + 1, 0])[-1]


def member(gamma, start, l_stable):
    """The member of the family near a start: its last row of order 5, the row `l_stable` L-stable."""

    def left(unknown):
        a, c = family(gamma, *unknown)
        return [a[6] @ a @ c**3 - 1 / 20, a[6] @ a[:, 1], at_infinity(a, l_stable)]

    found = scipy.optimize.fsolve(left, start, xtol=1e-12)
    assert np.max(np.abs(left(found))) < 1e-11
    return family(gamma, *found)


def test_the_same_conditions_give_the_method_that_is_known():
    """With the last row L-stable and γ = 0.26 they give Kværnø's 5/4a, whose coefficients are printed."""
    a, _ = member(0.26, (0.9, 0.43, 0.1), 6)
    assert_allclose(a, square("kvaerno5")[0], atol=1e-10)


def test_esdirk54b_is_a_member():
    a, c = member(0.27, (0.61, 0.645, 0.13), 5)
    known, _, _, times = square("esdirk54b")
    assert_allclose(known, a, atol=1e-9)
    assert_allclose(times, c, atol=1e-10)


def published():
    """Steps and errors of λ₂ between T = 1000 and T = 10000 in Table 4, where the motion is at rest."""
    rows = {(row.tolerance, row.length): row for row in linh_tables.PUBLISHED if row.table.number == 4}
    for tolerance in (1e-4, 1e-6):  # at 1e-5 the steps are not equal: λ₁ is off by 6e-8 there
        first, last = (rows[tolerance, length] for length in (1000, 10000))
        h = 9000 / (last.steps - first.steps)
        slope = (10000 * last.exponents[1] - 1000 * first.exponents[1]) / 9000
        yield h, slope - linh_tables.limits()[1]


@pytest.mark.parametrize(("gamma", "is_it"), [(0.26, False), (0.269, False), (0.27, True), (0.271, False)])
def test_the_tables_tell_which_member(gamma, is_it):
    """Two published errors: of the members with γ near 0.27 only that with γ = 0.27 has both."""
    rate, start = linh_tables.limits()[1], (0.61, 0.645, 0.13) if gamma > 0.265 else (0.56, 0.766, 0.0145)
    a, _ = member(gamma, start, 5)
    ratios = [(np.log(stability(a, a[6], rate * h)) / h - rate) / error for h, error in published()]
    print(gamma, ratios)
    assert (np.max(np.abs(np.array(ratios) - 1)) < 1e-3) == is_it
    # By the weights of order 4 no member has them.
    ratios = [(np.log(stability(a, a[5], rate * h)) / h - rate) / error for h, error in published()]
    assert np.max(np.abs(np.array(ratios) - 1)) > 0.1
