"""The comparison with other programs: what is converged, what is interpolated, and what the table says."""

import concurrent.futures
import json
import math
import threading
import time

import numpy as np
import pytest

import lyaphybrid as lh
from benchmarks.peers import __main__ as command
from benchmarks.peers import converged, conversation, measuring, tables, worker
from benchmarks.peers.adapters import OURS, PEERS, Bound, Peer
from benchmarks.peers.conversation import Conversation, FailedError
from benchmarks.peers.precision import Point, cost_at, wanted
from benchmarks.peers.workloads import WORKLOADS
from lyaphybrid.native.machine import tiers

TIGHT = lh.RungeKutta("dop853", rtol=1e-13, atol=1e-15)
ASKED = [(peer, name) for peer, one in PEERS.items() for name in WORKLOADS if one.can(WORKLOADS[name])]


def test_a_cost_lies_on_a_line_in_logarithms():
    points = [Point("rk4", 1e-2, 1.0), Point("rk4", 1e-4, 4.0), Point("rk4", 1e-8, 32.0)]
    assert cost_at(points, 1e-3) == pytest.approx(2.0)
    assert cost_at(points, 1e-5) == pytest.approx(4.0 * 8.0**0.25)
    assert cost_at(points, 1e-9) is None
    assert cost_at([*points, Point("dop853", 1e-10, 3.0)], 1e-5) == 3.0  # nothing coarser is known: as it is
    assert cost_at([], 1e-3) is None


def test_settings_beside_the_targets_are_timed():
    errors = {
        "rk4 1/5": 1e-2,
        "rk4 1/10": 1e-4,
        "rk4 1/20": 1e-5,
        "rk4 1/40": 1e-7,
        "rk6 1/5": math.inf,
        "rk6 1/9": 1e-4,
    }
    assert wanted(errors, [1e-3]) == [0, 1, 4, 5]
    assert wanted(errors, [1e-6]) == [2, 3]
    assert wanted(errors, [1e-9]) == []


def row(*points, **more):
    labels = ("rk4 coarse", "rk4 fine")
    found = {
        label: {"error": error, "seconds": seconds} for label, (error, seconds) in zip(labels, points, strict=True)
    }
    return {"points": found, "first": 1.5, "import": 0.5, "memory": 99.7} | more


def results(theirs):
    ours = row((1e-2, [10.0, 11.0]), (1e-4, [40.0, 80.0]))
    peers = {OURS: ours, "scipy": row((1e-2, theirs), (1e-4, theirs)), "numba": {"failed": "no answer in 60 s"}}
    return {"workloads": {"lorenz": {"title": "Lorenz", "unit": "unit of time", "length": 1000.0, "peers": peers}}}


def test_the_table_says_costs_and_ratios_at_the_same_error():
    workload = results([200.0])["workloads"]["lorenz"]
    assert tables.ratios(workload) == {("scipy", 1e-3): pytest.approx(10.0)}
    said = tables.table(workload)
    assert f"| {OURS} | 20 ms (25.1 ms) | – | – |  | 1.50 s | 0.50 s | 100 MB |" in said
    assert "| scipy | 200 ms | – | – | 10, –, – |" in said
    assert "| numba | – | – | – | –, –, – | – | – | – |" in said
    assert "numba: no answer in 60 s." in said


def test_what_is_worse_by_more_than_a_quarter_is_said():
    recorded = results([200.0])
    assert list(tables.worse(results([161.0]), recorded)) == []
    (line,) = tables.worse(results([159.0]), recorded)
    assert line == "lorenz, scipy, error 1e-03: 7.95 times, recorded 10"
    assert list(tables.worse(results([300.0]), recorded)) == []


@pytest.fixture
def measured(monkeypatch, tmp_path):
    """What the command measures, by the seconds of SciPy, written to a folder of its own."""
    monkeypatch.setattr(command, "DATA", tmp_path / "results.json")
    monkeypatch.setattr(command, "PAGE", tmp_path / "RESULTS.md")

    def choose(seconds):
        monkeypatch.setattr(measuring, "measure", lambda name, quick: results([seconds])["workloads"]["lorenz"])

    choose(200.0)
    return choose


def test_the_command_records_a_whole_run_and_checks_against_it(measured, capsys):
    assert command.main(["--check"]) == 2
    assert command.main(["--quick"]) == command.main(["--only", "lorenz"]) == 0
    assert not command.DATA.exists()
    for other in ("--quick", "--check", "--only=lorenz"):
        with pytest.raises(SystemExit):
            command.main(["--record", other])
    assert command.main(["--record"]) == 0
    assert list(json.loads(command.DATA.read_text())["workloads"]) == list(WORKLOADS)
    said = command.PAGE.read_text()
    assert said.startswith("# Ours and theirs")
    assert said.count("| scipy | 200 ms | – | – | 10, –, – |") == len(WORKLOADS)
    assert f"{OURS} {lh.__version__}" in said
    assert command.main(["--check", "--only", "lorenz"]) == 0
    measured(100.0)
    capsys.readouterr()
    assert command.main(["--check", "--only", "lorenz"]) == 1
    assert "lorenz, scipy, error 1e-03: 5 times, recorded 10" in capsys.readouterr().out


def test_a_program_that_is_not_installed_is_left_out(monkeypatch):
    monkeypatch.setitem(PEERS, "absent", Peer("no-such-distribution-of-lyaphybrid", "absent", ("map",), ""))
    assert "absent" in measuring.missing()
    assert measuring.able("henon_map")[0] == OURS
    assert "absent" not in measuring.able("henon_map")


def test_a_run_is_repeated_until_nothing_works_aside():
    calls, aside = [], []

    def run(setting, length):
        calls.append((setting, length))
        if len(calls) == 3:
            aside.append(threading.Thread(target=time.sleep, args=(0.3,), name=tiers.THREAD))
            aside[0].start()
        time.sleep(0.01)
        return [1.0, 2.0]

    with concurrent.futures.ThreadPoolExecutor() as pool:  # its threads wait for more work
        pool.submit(int).result()
        found = worker.repeated(Bound({"exact": "how"}, run), 0, 5.0, 0.05)
    assert found["exponents"] == [2.0, 1.0]
    assert 3 <= len(calls) <= 6
    assert set(calls) == {("how", 5.0)}
    assert not aside[0].is_alive()


@pytest.mark.parametrize(("rate", "longer"), [(1e-3, 1), (4e-5, 10), (1e-7, 100)])
@pytest.mark.parametrize("peer", ["scipy", "lyapax", OURS])
def test_a_run_is_long_enough_that_its_call_costs_little(rate, longer, peer):
    """Up to a hundred times as long; what compiles for each length has run with it before it is timed."""
    asked = []

    class Worker:
        def ask(self, setting, length, repeated=None):
            asked.append((length, repeated))
            return {"seconds": rate * length}

    assert measuring.long_enough(Worker(), peer, 3, 1000.0) == (1000.0 * longer, rate * (1000.0 * longer))
    timed = [length for length, repeated in asked if repeated is None]
    assert timed == [1000.0 * times for times in (1, 10, 100) if times <= longer]
    before = [length for length, repeated in asked if repeated is not None]
    assert before == (timed if PEERS[peer].by_length else [])


def test_costs_are_those_of_each_length():
    """A point that was timed over ten times the length took ten times as long for a unit less."""
    found = results([1.0])["workloads"]["lorenz"]
    for point in found["peers"]["scipy"]["points"].values():
        point["length"] = 10 * found["length"]
    least = tables.costs(results([1.0])["workloads"]["lorenz"])["scipy"]
    assert tables.costs(found)["scipy"] == {error: one and pytest.approx(one / 10) for error, one in least.items()}


def test_a_worker_that_ends_says_why():
    with Conversation("nobody", "henon_map") as worker, pytest.raises(FailedError, match="KeyError: 'nobody'"):
        worker.listen()


@pytest.mark.slow
@pytest.mark.parametrize("name", WORKLOADS)
def test_converged_values_are_ours(name):
    from benchmarks.peers.adapters import ours

    workload = WORKLOADS[name]
    bound = ours.KINDS[workload.kind](workload)
    tight = {"stiff": lh.RadauIIA(1e-12)}.get(workload.kind, TIGHT if workload.steps else None)
    exact = converged.exponents(workload, workload.frame)
    if workload.sweep:
        points = workload.sweep.values(workload.short)
        singles = [ours.KINDS[workload.sweep.kind](workload.at(value)) for value in points]
        found = [one.run({"method": tight}, workload.sweep.t1) for one in singles]
    elif tight:
        found = bound.run({"method": tight}, workload.short)
    else:
        found = bound.run(bound.ladder["exact"], workload.short)
    np.testing.assert_allclose(np.sort(np.ravel(found))[::-1], exact, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("peer", "name"), ASKED)
def test_a_program_reaches_a_small_error(peer, name, monkeypatch):
    monkeypatch.setattr(conversation, "PATIENCE", 600.0)  # beside other tests
    if PEERS[peer].version is None:
        pytest.skip(f"{peer} is not installed")
    with Conversation(peer, name) as worker:
        found = measuring.begin(worker, WORKLOADS[name].short)
        points = measuring.climb(worker, name, found)
    assert min(one["error"] for one in points.values()) < 1e-6
