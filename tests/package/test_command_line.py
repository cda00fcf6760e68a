"""The command line: what it prints and where, its exit status, its files."""

import contextlib
import io
import itertools
import json
import os
import subprocess
import sys

import pytest

from benchmarks import __main__ as benchmarks_module
from benchmarks import first_calls
from benchmarks.__main__ import main as benchmarks_main
from lyaphybrid import zoo
from lyaphybrid.__main__ import main
from lyaphybrid.engine.host.reporting import line_of_progress
from lyaphybrid.papers.dinius import reproduction as dinius

KEYS = [
    "name",
    "parameters",
    "exponents",
    "stderr",
    "error_kind",
    "t1",
    "jumps",
    "status",
    "notes",
    "reference",
]


def run_alone(*arguments, **keywords) -> subprocess.CompletedProcess:
    """The command in a process of its own, in which nobody has set the precision."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    command = [sys.executable, "-m", "lyaphybrid", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False, **keywords)


def parsed(capsys) -> dict:
    """The one JSON object on standard output."""
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 1
    return json.loads(captured.out, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))


def test_list_names_every_problem_with_its_reference(capsys):
    assert main(["list"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for name in zoo.names():
        assert f"\n{name} " in f"\n{out}"
    assert "0.9624236501" in out
    assert out.count("reference: ") == len(zoo.names())


@pytest.mark.slow
def test_a_spectrum_prints_its_table(capsys):
    assert main(["spectrum", "henon_map", "--set", "a=1.3", "--set", "b=0.3", "--t1", "500"]) == 0
    out, err = capsys.readouterr()
    assert "henon_map(a=1.3, b=0.3)" in out
    assert "λ2" in out
    assert "status ok" in out
    assert err == ""


def test_json_has_exactly_the_contract_s_keys(capsys):
    assert main(["spectrum", "henon_map", "--t1", "500", "--json"]) == 0
    data = parsed(capsys)
    assert list(data) == KEYS
    assert data["name"] == "henon_map"
    assert data["parameters"] == {"a": 1.4, "b": 0.3}
    assert (data["t1"], data["jumps"], data["status"], data["error_kind"]) == (500.0, 500, "ok", "blocks")
    assert sum(data["exponents"]) == pytest.approx(-1.2039728043, abs=1e-9)
    assert len(data["stderr"]) == 2
    assert data["reference"]["exponents"] == list(zoo.henon_map().reference.exponents)
    assert data["notes"] == []


@pytest.mark.slow
def test_minus_infinity_is_a_string(capsys):
    assert main(["spectrum", "grow_reset", "--set", "q=0", "--t1", "20", "--transient", "0", "--json"]) == 0
    data = parsed(capsys)
    assert data["exponents"][-1] == "-inf"
    assert data["stderr"][-1] is None
    assert data["reference"]["exponents"][-1] == "-inf"
    assert data["notes"] == ["rank_lost"]


def test_a_run_that_fails_says_so_and_gives_what_it_has(capsys):
    assert main(["spectrum", "henon_map", "--set", "a=3", "--t1", "500", "--transient", "0", "--json"]) == 1
    captured = capsys.readouterr()
    data = json.loads(captured.out)
    assert data["status"] == "nonfinite"
    assert data["reference"] is None
    assert "nonfinite" in captured.err


@pytest.mark.slow
def test_replicates_are_seeded(capsys):
    def run(seed):
        assert main(["spectrum", "henon_map", "--t1", "500", "--replicates", "3", "--seed", seed, "--json"]) == 0
        return parsed(capsys)

    first, again, other = run("1"), run("1"), run("2")
    assert first["error_kind"] == "replicates"
    assert first == again
    assert first["exponents"] != other["exponents"]


@pytest.mark.slow
def test_the_seed_chooses_a_random_start(capsys):
    def run(seed):
        assert main(["spectrum", "hard_disks", "--t1", "5", "--k", "1", "--seed", seed, "--json"]) == 0
        return parsed(capsys)["exponents"]

    assert len(run("1")) == 1
    assert run("1") != run("2")


def test_a_tolerance_reaches_the_method(capsys):
    def run(*tolerance):
        options = ["--t1", "2", "--transient", "0", "--k", "1", *tolerance, "--json"]
        assert main(["spectrum", "lorenz63", *options]) == 0
        return parsed(capsys)["exponents"][0]

    tight, loose = run("--rtol", "1e-12"), run("--rtol", "1e-3", "--atol", "1e-3")
    assert abs(loose - tight) > 10 * abs(run() - tight)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["spectrum", "lorentz63"], "lorenz63"),
        (["spectrum", "lorenz63", "--set", "ro=30"], "'rho'"),
        (["spectrum", "lorenz63", "--set", "rho=many"], "rho must be a finite real number"),
        (["spectrum", "lorenz63", "--set", "rho=nan"], "rho must be a finite real number"),
        (["spectrum", "lorenz63", "--set", "rho"], "KEY=VALUE"),
        (["spectrum", "hard_disks", "--set", "n=2.5"], "n must be a whole number"),
        (["spectrum", "hard_disks", "--set", "key=1"], "--seed"),
        (["spectrum", "lorenz63", "--t1", "0"], "t1"),
        (["spectrum", "lorenz63", "--t1", "inf"], "t1"),
        (["spectrum", "lorenz63", "--t1", "long"], "--t1"),
        (["spectrum", "lorenz63", "--k", "4"], "k must be at most n = 3"),
        (["spectrum", "lorenz63", "--replicates", "1"], "replicates must be an integer of at least 2"),
        (["spectrum", "lorenz63", "--rtol", "-1"], "--rtol must be positive"),
        (["spectrum", "henon_map", "--rtol", "1e-6"], "henon_map is a map"),
        (["spectrum", "hard_disks", "--atol", "1e-6"], "hard_disks is exact"),
        (["spectrum"], "NAME"),
        (["papers", "dinious"], "there are: dinius, fu, linh, skokos"),
        (["papers"], "PAPER"),
        (["swipe", "lorenz63"], "'list', 'spectrum', 'sweep', 'reference', 'validate', 'papers'"),
        (["sweep", "lorenz63"], "--over"),
        (["--rapid"], "--rapid"),
    ],
)
def test_what_does_not_exist_is_refused_with_what_does(arguments, says, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert "Traceback" not in err


def test_a_folder_that_cannot_be_made_is_refused_before_computing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(dinius, "reproduce", lambda **_: pytest.fail("it computed"))
    file = tmp_path / "taken"
    file.write_text("")
    assert main(["papers", "dinius", "--out", str(file)]) == 2
    assert "cannot be made" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_are_no_failures(option, capsys):
    assert main([option]) == 0
    assert capsys.readouterr().out.startswith("usage: lyaphybrid" if option == "--help" else "lyaphybrid ")


class Stub:
    """Stands for a result of `dinius.reproduce`."""

    def __init__(self, passed):
        self.passed = passed

    def __str__(self):
        return "the table"


@pytest.mark.parametrize(
    ("arguments", "quick", "folder"),
    [([], False, "lyaphybrid-out"), (["papers", "dinius", "--quick", "--out", "a/b"], True, "a/b")],
)
@pytest.mark.parametrize("passed", [True, False])
def test_the_main_job(arguments, quick, folder, passed, monkeypatch, tmp_path, capsys):
    asked = {}

    def reproduce(**keywords):
        asked.update(keywords)
        return Stub(passed)

    def write(result, out):
        (out / "dinius.json").write_text("{}")
        return [out / "dinius.json"]

    monkeypatch.setattr(dinius, "reproduce", reproduce)
    monkeypatch.setattr(dinius, "write", write)
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == (0 if passed else 1)
    assert asked == {"quick": quick, "progress": None}
    assert (tmp_path / folder / "dinius.json").exists()
    assert "the table" in capsys.readouterr().out


def test_interrupted(monkeypatch, tmp_path, capsys):
    def interrupt(**_):
        raise KeyboardInterrupt

    monkeypatch.setattr(dinius, "reproduce", interrupt)
    monkeypatch.chdir(tmp_path)
    assert main([]) == 130
    assert "interrupted" in capsys.readouterr().err


@pytest.mark.slow
def test_it_sets_double_precision_itself_and_prints_nothing_else():
    done = run_alone("spectrum", "cat_map", "--t1", "200", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    data = json.loads(done.stdout)
    assert data["exponents"][0] == pytest.approx(data["reference"]["exponents"][0], abs=1e-9)


@pytest.mark.slow
def test_the_main_job_itself(tmp_path):
    done = run_alone(cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "passed" in done.stdout
    files = {file.name for file in (tmp_path / "lyaphybrid-out").iterdir()}
    assert files == {"dinius.png", "dinius.pdf", "dinius.json"}


@pytest.mark.slow
def test_a_sweep_prints_its_points_and_is_taken_up(capsys, tmp_path):
    command = ["sweep", "henon_map", "--over", "a=1.0:1.4:3", "--set", "b=0.3", "--t1", "500"]
    store = ["--store", str(tmp_path / "sweep.zarr")]
    assert main([*command, *store]) == 0
    first = capsys.readouterr().out.splitlines()
    assert len(first) == 4
    assert first[0].startswith("a=1  ")
    assert first[2].startswith("a=1.4  ")
    assert "3 points in" in first[3]
    assert "3 ok" in first[3]
    assert main([*command, *store]) == 2
    assert "--resume goes on with it" in capsys.readouterr().err
    assert main([*command, *store, "--resume"]) == 0
    assert capsys.readouterr().out.splitlines()[:3] == first[:3]
    spectrum = zoo.henon_map(a=1.4, b=0.3).spectrum(t1=500)
    assert f"{float(spectrum.exponents[0]): .6g}" in first[2]


@pytest.mark.slow
def test_a_sweep_of_many_points_says_what_there_is_between(capsys):
    assert main(["sweep", "logistic_map", "--over", "r=3.6:4.4:41", "--t1", "200"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("λ1 from ")
    assert "nonfinite" in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--over", "a=1:2"], "KEY=LOW:HIGH:COUNT"),
        (["--over", "a=1:2:0"], "KEY=LOW:HIGH:COUNT"),
        (["--over", "c=1:2:3"], "no parameter 'c' that can be swept; it has a, b"),
        ([], "Nothing to sweep"),
        (["--over", "a=1:1.2:2", "--over", "a=1:1.4:2"], "--over names a twice"),
        (["--over", "a=1:1.2:2", "--set", "a=1"], "a is an axis of the sweep, --over"),
        (["--over", "a=1:1.2:2", "--resume"], "--resume goes on with a store"),
    ],
)
def test_a_sweep_that_does_not_fit_is_refused(arguments, says, capsys):
    assert main(["sweep", "henon_map", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_who_reads_may_have_enough():
    """As `lyaphybrid list | head -1`."""
    command = [sys.executable, "-m", "lyaphybrid", "list"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as listing:
        listing.stdout.close()
        assert listing.stderr.read() == b""
    assert listing.returncode == 0


def test_every_command_has_examples_that_can_be_typed(capsys):
    """Each is one that the parser takes; of the first command nothing is computed."""
    from lyaphybrid.__main__ import _parser
    from lyaphybrid._options import TYPED

    for name, examples in TYPED.items():
        assert main([*([name] if name else []), "--help"]) == 0
        said = capsys.readouterr().out
        for typed, what in examples:
            assert f"  {typed}\n      {what}" in said
            program, *arguments = typed.split()
            assert program == "lyaphybrid"
            with contextlib.suppress(SystemExit):  # a help ends
                assert _parser().parse_args(arguments).run
            problem = next((one for one in arguments if one in zoo.names()), None)
            swept = [
                one.partition("=")[0] for flag, one in itertools.pairwise(arguments) if flag in ("--set", "--over")
            ]
            assert problem is None or set(swept) <= set(zoo.get(problem)().parameters)
    assert set(TYPED) == {"", "list", "spectrum", "sweep", "reference", "validate", "papers"}


def test_progress_goes_to_standard_error_where_it_is_wanted(capsys):
    command = ["spectrum", "henon_map", "--t1", "1e5", "--json"]
    assert main([*command, "--progress"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["name"] == "henon_map"
    lines = err.splitlines()
    assert lines[0] == "henon_map: compiling"
    assert lines[-1].startswith("henon_map: 100 % after ")
    assert len(lines) < 14
    assert main([*command, "--no-progress"]) == 0
    assert capsys.readouterr().err == ""
    assert main(command) == 0  # no terminal
    assert capsys.readouterr().err == ""


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_on_a_terminal_progress_is_one_line_that_is_cleared():
    stream = Terminal()
    with line_of_progress("henon_map", stream) as progress:
        for done in (0.0, 0.001, 0.5, 1.0):
            progress(done)
    said = stream.getvalue()
    assert "\n" not in said
    assert said.count("%") == 3
    assert said.endswith("\r\x1b[K\r")


def test_programs_of_benchmarks_have_a_help(capsys):
    for program, word in ((first_calls.main, "lorenz63"), (benchmarks_main, "--only")):
        with pytest.raises(SystemExit) as end:
            program(["--help"])
        assert end.value.code == 0
        assert word in capsys.readouterr().out
    with pytest.raises(SystemExit):
        first_calls.main(["lorenz"])
    assert "no problem is called lorenz" in capsys.readouterr().err


def test_each_case_of_the_benchmarks_is_printed_when_it_is_done(monkeypatch, capsys):
    printed = []

    def row(name, quick, side):
        printed.append(len(capsys.readouterr().out.splitlines()))
        return {"case": name, "unit": "step", "peak_memory_mb": 1.0}

    monkeypatch.setattr(benchmarks_module, "_row_of_child", row)
    assert benchmarks_main(["--quick", "--side", "ours"]) == 0
    assert printed == [1] * len(benchmarks_module.CASES)  # the head, then a line between each two
