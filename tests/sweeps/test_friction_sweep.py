"""The friction pendulum against β: exponents, attractors, bifurcations and lifetimes of an independent computation."""

import csv

import numpy as np
import pytest

import lyaphybrid as lh
import references
from lyaphybrid.papers.fu import cases
from lyaphybrid.papers.fu import reproduction as fu

pytestmark = pytest.mark.slow

STEP = 1e-3  # of the grid in β
TRANSIENT = 0.009  # below it chaos is transient: which cycles a run finds is luck, and a matter of its length
SYSTEM, _, ARGS = fu._problem(cases.CASES[2])
ONE_FOLD = "fold of P1w3"  # in transient chaos


def diagram(values, x0=cases.BOX, **options):
    over = {"beta": np.asarray(values)}
    return lh.bifurcation_diagram(SYSTEM, x0, ARGS, over=over, period=cases.PERIOD, angles=(0,), **options)


def rows_of_the_reference():
    with (references.DATA / "friction_beta_sweep.csv").open() as file:
        return list(csv.DictReader(file))


def classes_of(row) -> dict[str, int]:
    """How many of the six starts ended on which attractor."""
    counted = (entry.rsplit(":", 1) for entry in row["classes(count of 6 ICs)"].split(";"))
    return {name: int(count) for name, count in counted}


def is_chaotic(label: str) -> bool:
    """Which of the two a weak chaos is called depends on the length of the run."""
    return label in ("chaos", "aperiodic/slow")


@pytest.fixture(scope="module")
def sweep():
    """The diagram of Fig. 4: four random starts for each β, followed up and down, 1100 periods each."""
    found = diagram(np.round(np.arange(301) * STEP, 6), transient=500, t1=600)
    assert np.all(found.status == 0)
    return found


def at(found, beta) -> int:
    return int(np.argmin(np.abs(found.values - float(beta))))


def test_the_largest_exponent_is_that_of_the_reference(sweep):
    """Wherever all six of its starts have found the same attractor."""
    alone = 0
    for row in rows_of_the_reference():
        if len(classes_of(row)) > 1:
            continue
        (label,), i = classes_of(row), at(sweep, row["beta"])
        same = sweep.labels[i] == label
        assert same.sum() >= 2, (row["beta"], sweep.labels[i])
        mean, own = np.mean(sweep.exponents[i, same, 0]), np.sqrt(np.mean(sweep.stderr[i, same, 0] ** 2) / same.sum())
        assert own < 0.005
        # Of cycles the reference tells no error: ours is from the way there.
        error = np.hypot(max(own, 1e-4), float(row["se"]))
        assert abs(mean - float(row["lambda_max_majority"])) < 5 * error, row["beta"]
        alone += 1
    assert alone == 62


def test_every_attractor_of_two_starts_is_found(sweep):
    several = 0
    for row in rows_of_the_reference():
        if float(row["beta"]) < TRANSIENT:
            continue
        labels = sweep.labels[at(sweep, row["beta"])]
        wanted = [label for label, count in classes_of(row).items() if count >= 2]
        several += len(wanted) > 1
        for label in wanted:
            alike = [is_chaotic(one) if is_chaotic(label) else one == label for one in labels]
            assert any(alike), (row["beta"], label, labels)
    assert several == 7
    for beta, only in ((0.144, {"P3w0", "P2w0"}), (0.148, {"P3w0", "P1w0"}), (0.152, {"P3w0", "P1w0"})):
        assert set(sweep.labels[at(sweep, beta)]) == only


CYCLES = {"P1": "P1w0", "P3": "P3w0", "P5": "P5w0", "P5b": "P5w0", "P5c": "P5w0"}
DOUBLED = {"P1": "P2w0", "P3": "P6w0", "P3w2": "P6w4", "P2w1": "P4w2"}
SYMMETRIC_BELOW = 0.2486769  # everywhere else the cycle is symmetric above
LISTED = [one for one in cases.BIFURCATIONS if one[1] != ONE_FOLD]


def is_symmetric(found, row: int, run: int) -> bool:
    """Whether the cycle is its own image under (θ, t) → (-θ, t + T/2), so far as the motion has come."""
    points, args = found.points[row, run], ARGS | {"beta": np.asarray(found.values[row])}
    half = lh.trajectory(SYSTEM, points[-1], args, t1=cases.PERIOD / 2, n=2).x[-1]
    gap = points + np.asarray(half)
    gap[:, 0] -= 2 * np.pi * np.round(gap[:, 0] / (2 * np.pi))
    return bool(np.min(np.max(np.abs(gap), axis=1)) < 1e-2)


@pytest.mark.parametrize(("beta", "what"), LISTED, ids=[f"{what} {beta:.4f}" for beta, what in LISTED])
def test_bifurcations_are_within_one_step_of_the_grid(sweep, beta, what):
    """Where what lives below β is seen for the last time, and the next value."""
    kind, name = what.split(" of ")
    label = DOUBLED[name] if kind == "doubling" else CYCLES.get(name, name)
    near = np.flatnonzero(np.abs(sweep.values - beta) < 4.5 * STEP)
    runs = {i: np.flatnonzero(sweep.labels[i] == label) for i in near}
    if kind == "symmetry":
        runs = {i: [r for r in runs[i] if is_symmetric(sweep, i, r) == (beta == SYMMETRIC_BELOW)] for i in near}
    seen = [sweep.values[i] for i in near if len(runs[i])]
    assert seen
    assert max(seen) < sweep.values[near[-1]]
    assert max(seen) - STEP <= beta <= max(seen) + 2 * STEP


# --- transient chaos ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def escapes():
    return diagram([0.004], starts=64, directions=("random",), transient=100, t1=3900, escape=True)


def test_chaos_is_transient(escapes):
    mean, error = escapes.mean_lifetimes()
    assert 6300 / 2 < mean[0] < 6300 * 2
    assert error[0] < 0.3 * mean[0]
    assert 20 < escapes.escaped.sum() < 64
    # Points that have escaped are labelled by the cycle on which they ended, if need be after some more time.
    escaped = escapes.escaped[0]
    assert not any(label == "chaos" for label in escapes.labels[0, escaped])
    settling = escaped & (escapes.labels[0] == "aperiodic/slow")
    assert all(label.startswith("P") for label in escapes.labels[0, escaped & ~settling])
    if np.any(settling):
        points = escapes.points[0, settling, -1]
        more = diagram([0.004], points[0], starts=points, directions=("random",), transient=1, t1=3000)
        assert all(label.startswith("P") for label in more.labels.flat)


def test_the_cycle_that_chaos_escapes_to_is_followed_up_to_its_fold(escapes):
    (beta,) = (beta for beta, what in cases.BIFURCATIONS if what == ONE_FOLD)
    start = escapes.points[escapes.labels == "P1w3"][0, -1]
    # Near the fold the basin is so narrow that steps of 1e-3 lose the cycle one step early.
    values = np.round(np.arange(0.01, 0.0165, STEP / 2), 6)
    found = diagram(values, start, starts=start[None], directions=("up",), transient=100, t1=1900)
    np.testing.assert_array_equal(found.labels[values < beta, 0], "P1w3")
    assert not np.any(found.labels[values > beta, 0] == "P1w3")
