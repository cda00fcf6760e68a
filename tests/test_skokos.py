"""Skokos & Gerlach: what the reproduction computes, what its checks would see, and its figures."""

import dataclasses
import functools
import json

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.__main__ import main
from lyaphybrid.papers import skokos, skokos_checks, skokos_report
from lyaphybrid.statuses import STATUS

STARTS = {  # as the paper gives them, or where they are lost as they were found again
    "R1": (0.0, 0.55, 0.2416954005906332, 0.0),
    "C1": (0.0, -0.016, 0.49974120235711333, 0.0),
    "C2": (0.0, -0.01333, 0.49982069988944566, 0.0),
    "R2": (0.0, 0.0, 0.0, 0.1, 0.3467104740294315, 0.0),
    "R3": (0.1,) * 8 + (0.0,) * 8,
}


@pytest.mark.parametrize("name", list(STARTS))
def test_orbits_start_where_the_paper_s_do(name):
    _, x0, _ = skokos._problem(name)
    np.testing.assert_allclose(x0, STARTS[name], rtol=0, atol=1e-12)


def test_laws_of_the_galis():
    """Equations (58) and (59), and the 4-torus of eight degrees of freedom."""
    assert skokos_checks.law(skokos.ORBITS["R1"]) == [0, -2, -4]
    assert skokos_checks.law(skokos.ORBITS["R2"]) == [0, 0, -2, -4, -6]
    assert skokos_checks.law(skokos.ORBITS["R3"]) == [0, 0, 0, -1, -2, -3, -4, -5, -6, -7, -8, -10, -12, -14, -16]


def test_table_1_has_the_paper_s_rows():
    assert len(skokos.TABLE) == 17
    assert [row.minutes for row in skokos.TABLE[:5]] == [8 * 60 + 18, 5 * 60 + 48, 5 * 60 + 36, 6 * 60 + 3, 4 * 60 + 40]
    for row in skokos.TABLE:
        assert (row.threshold is not None) is (row.method == "DOP853")
    kinds = {row.method: type(skokos.method_of(row.method, row.step, row.threshold)) for row in skokos.TABLE}
    assert kinds["TM"] is lh.Symplectic
    assert kinds["TDHes"] is lh.TangentHamiltonian


# A reproduction made by hand, in which all laws hold, and what each check says where one is broken.

TIME = np.geomspace(10.0, 1e6, 201)


def run(first, n=4, energy=1e-10, error=1e-3):
    """λ₁ = first(t), λ₂ = 1/t, and their partners."""
    values = np.zeros((len(TIME), n))
    values[:, 0], values[:, 1] = first(TIME), 1 / TIME
    values[:, n // 2 :] = -values[:, : n // 2][:, ::-1]
    return skokos.Run(TIME, values, error, energy)


def falling(time):
    return np.log(time) / time


def levelled(value):
    return lambda time: value + np.log(time) / time


def powers(orbit):
    logs = np.log(TIME)[:, None] * np.array(skokos_checks.law(skokos.ORBITS[orbit]))[None, :]
    return alignment(logs, orbit)


def alignment(logs, orbit):
    code = jnp.asarray(int(STATUS.ok))
    return lh.Alignment(jnp.asarray(TIME), jnp.asarray(logs), code, skokos.ORBITS[orbit].orders)


def sea(rate=0.0443):
    return alignment(-rate * TIME[:, None] * np.array([1, 2, 4])[None, :], "C1")


class Section:
    """As much of a section as is asked for."""

    def __init__(self, points):
        self.x = points


def sections():
    turn = 2 * np.pi * np.arange(500) / 5
    islands = np.stack([0 * turn, np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    scattered = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 4))
    return {"R1": Section(islands), "C1": Section(scattered), "C2": Section(1e-3 * scattered)}


LEVEL = {"TDHcc": 1.5e-3, "TDHes": 1.5e-3, "TDHeps": 7.8e-5}


def row_run(row):
    if row.method in LEVEL:
        return run(levelled(LEVEL[row.method] * (row.step / 0.05) ** 2))
    return run(falling)


@functools.cache
def by_hand() -> skokos.Reproduction:
    fall = {method: levelled(LEVEL[method]) if method in LEVEL else falling for method in skokos.METHODS}
    shown = {method: run(falling if method != "TDHeps" else levelled(4.9e-5), 6) for method in skokos.BEST}
    false, false_eps = (alignment(-np.outer(TIME * fall[m](TIME) - 1, [1, 2, 4]), "R1") for m in ("TDHcc", "TDHeps"))
    return skokos.Reproduction(
        tuple(row_run(row) for row in skokos.TABLE),
        (1.0,) * len(skokos.TABLE),
        {
            "C1": {method: run(lambda t: 0.0443 + 0 * t) for method in skokos.METHODS},
            "C2": {method: run(lambda t: 2e-4 + 0 * t) for method in skokos.METHODS},
            "R2": shown,
        },
        {
            "R1": {"TDHcc": false, "TDHes": false, "TDHeps": false_eps, "DOP853": powers("R1"), "TM": powers("R1")},
            "C1": {method: sea() for method in skokos.METHODS},
            "C2": {method: sea(1e-4) for method in skokos.METHODS},
            "R2": {method: powers("R2") for method in skokos.BEST},
            "R3": {method: powers("R3") for method in skokos.BEST},
        },
        sections(),
        skokos.QUICK,
    )


def test_the_checks_hold_where_the_laws_do():
    found = by_hand()
    assert found.passed, [name for name, holds in found.checks.items() if not holds]
    assert "passed: all" in str(found)
    assert "TDHeps" in str(found)


def in_table(method, step, **changes):
    def broken(r):
        chosen = [(row.method, row.step) == (method, step) for row in skokos.TABLE]
        table = [dataclasses.replace(run, **changes) if one else run for one, run in zip(chosen, r.table, strict=True)]
        return dataclasses.replace(r, table=tuple(table))

    return broken


def in_runs(orbit, method, new):
    return lambda r: dataclasses.replace(
        r, exponents=r.exponents | {orbit: r.exponents[orbit] | {method: new(r.exponents[orbit][method])}}
    )


def in_indices(orbit, method, new):
    return lambda r: dataclasses.replace(
        r, indices=r.indices | {orbit: r.indices[orbit] | {method: new(r.indices[orbit][method])}}
    )


def in_sections(orbit, points):
    return lambda r: dataclasses.replace(r, sections=r.sections | {orbit: Section(points)})


def flatter(found):
    return alignment(0.8 * np.asarray(found.log_values), "R3" if len(found.orders) > 5 else "R1")


UNPAIRED = np.array([1.0, 0.0, 0.0, 0.0])
BROKEN = [
    (in_table("TM", 0.05, exponents=run(levelled(5e-5)).exponents), "TM: λ1 of R1 falls"),
    (in_table("DOP853", 0.05, energy=1e-8), "DOP853: energy"),
    (in_table("TDHcc", 0.05, exponents=run(levelled(4e-3)).exponents), "TDHcc: λ1 of R1 levels"),
    (in_table("TDHeps", 0.1, exponents=run(levelled(1.6e-4)).exponents), "level goes with τ²"),
    (in_table("TDHeps", 0.05, exponents=run(falling).exponents), "TDHeps: λ1 of R1 levels"),
    (in_runs("R2", "TDHeps", lambda _: run(falling, 6)), "λ1 of R2 levels"),
    (in_runs("R2", "TM", lambda _: run(levelled(1e-4), 6)), "TM: λ1 of R2 falls"),
    (
        in_runs("C1", "TM", lambda r: dataclasses.replace(r, exponents=r.exponents + 1e-3 * UNPAIRED)),
        "C1: exponents come in pairs",
    ),
    (in_runs("C1", "DOP853", lambda _: run(lambda t: 0.05 + 0 * t)), "DOP853: λ1 of C1"),
    (in_runs("C2", "TM", lambda _: run(lambda t: 0.04 + 0 * t)), "TM: C2 is weakly"),
    (in_indices("R1", "TM", flatter), "TM: GALIs of R1"),
    (in_indices("R3", "DOP853", flatter), "DOP853: GALIs of R3"),
    (in_indices("R1", "TDHeps", lambda _: powers("R1")), "TDHeps: GALI_2 of R1"),
    (in_indices("C1", "TM", lambda _: powers("R1")), "TM: ln GALI_k of C1"),
    (in_sections("R1", np.random.default_rng(1).uniform(-0.5, 0.5, (500, 4))), "five islands"),
    (in_sections("C1", sections()["R1"].x), "C1 is scattered"),
]


@pytest.mark.parametrize(("broken", "says"), BROKEN, ids=[says for _, says in BROKEN])
def test_each_check_sees_its_law_broken(broken, says):
    found = broken(by_hand())
    failed = [name for name, holds in found.checks.items() if not holds]
    assert any(says in name for name in failed), failed
    assert not found.passed
    assert "FAILED" in str(found)


def test_figures_show_every_panel():
    found = by_hand()
    panels = {1: 1, 2: 10, 3: 2, 4: 5, 5: 3, 6: 2, 7: 10, 8: 5, 9: 6, 10: 3, 11: 6}
    for number, count in panels.items():
        axes = found.figure(number).axes
        assert len(axes) == count
        assert all(ax.get_lines() for ax in axes)
    # The first curve of Fig. 2 is log10 of λ₁ by DOP853.
    line = found.figure(2).axes[0].get_lines()[0]
    np.testing.assert_allclose(line.get_ydata(), np.log10(found.of("R1")["DOP853"].exponents[:, 0]))
    with pytest.raises(ValueError, match="1 to 11"):
        found.figure(12)


def test_numbers_are_json():
    data = json.loads(json.dumps(skokos_report.numbers(by_hand()), allow_nan=False))
    assert data["passed"]
    assert len(data["table_1"]) == 17
    assert len(data["log_gali"]["R3"]["TM"]["orders"]) == 15


def test_progress_tells_how_many_runs_are_done():
    fractions = []
    assert skokos._all({1: (abs, -3), 2: (abs, 4)}, fractions.append) == {1: 3, 2: 4}
    assert fractions == [0.5, 1.0]


@pytest.mark.slow
def test_the_figures_by_the_command_line(tmp_path, capsys):
    assert main(["papers", "skokos", "--quick", "--out", str(tmp_path)]) == 0
    assert "passed: all" in capsys.readouterr().out
    names = [f"skokos-{number}.{kind}" for number in range(1, 12) for kind in ("png", "pdf")]
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*names, "skokos.json"])
    data = json.loads((tmp_path / "skokos.json").read_text())
    assert data["passed"]
    assert all(data["checks"].values())
