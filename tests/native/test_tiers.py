"""Code that is ready at once, and better code that follows: the same bits, and no call waits for it."""

import os
import subprocess
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid._jax import engines as _engines
from lyaphybrid.native import Compiled
from lyaphybrid.native.lowering.costs import plan
from lyaphybrid.native.machine import tiers as _tiers

PROBLEMS = {  # flows, events, maps, disks, a DAE, and sums of more terms than are written out
    "lorenz63": {"t1": 30.0},
    "friction_pendulum": {"t1": 30.0},
    "hard_disks": {"t1": 3.0},
    "henon_map": {"t1": 300},
    "lorenz96": {"t1": 2.0},
    "pendulum_dae": {"t1": 3.0},
}


@pytest.fixture
def made(monkeypatch):
    """The levels of the code that LLVM made, in turn; nothing comes from the disk."""
    levels: list[int] = []

    def counted(make):
        return lambda text, level, *rest, **named: levels.append(level) or make(text, level, *rest, **named)

    monkeypatch.setenv("LYAPHYBRID_CACHE", "off")
    for name in ("object_code", "object_code_aside"):
        monkeypatch.setattr(_tiers, name, counted(getattr(_tiers, name)))
    return levels


def finished():
    """Wait for better code that is being made."""
    for thread in threading.enumerate():
        if thread.name == _tiers.THREAD:
            thread.join()


def sums(x):
    """(40, 21) -> sums along both axes and of all, a product of matrices, a norm."""
    return x.sum(0), x.sum(1), x.sum(), x @ x.T, jnp.sqrt((x * x).sum()), jnp.cumsum(x, 0)


def set_costs(program, middle: float, best: float, monkeypatch):
    """Estimated seconds for the second and the third code of a program."""
    costs = program.code._costs
    monkeypatch.setattr(program.code, "_costs", dict(zip(costs, (middle, best), strict=True)))


def compiled(x, **options):
    return Compiled(jax.make_jaxpr(sums)(x), **options)


def written_out():
    """A program whose numbers are written out one by one, which LLVM takes seconds to optimise."""

    def step(x):
        for _ in range(60):
            x = jnp.stack([jnp.sin(x[i - 1]) * x[i] + jnp.cos(x[i - 2]) for i in range(6)])
        return x

    return Compiled(jax.make_jaxpr(lambda x: jax.lax.fori_loop(0, 10, lambda _, x: step(x), x))(np.ones(6)))


def same(xs, ys):
    return all(np.array_equal(x, y) for x, y in zip(xs, ys, strict=True))


def test_all_levels_give_the_same_bits(made):
    x = np.random.default_rng(1).normal(size=(40, 21))
    best = plan(jax.make_jaxpr(sums)(x).jaxpr)
    results = [compiled(x, plan=best._replace(level=level))(x) for level in (0, 1, 2, 3)]
    assert made == [0, 1, 2, 3]
    assert all(same(results[0], other) for other in results[1:])


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_problems_have_the_same_bits_at_once_and_later(name, made, monkeypatch):
    problem, found = lh.zoo.get(name)(), []
    for level in (_tiers.FIRST_LEVEL, 2):
        _engines.forget_programs()
        monkeypatch.setattr(_tiers, "FIRST_LEVEL", level)
        made.clear()
        found.append(problem.spectrum(**PROBLEMS[name], throw=False))
        assert level in made
    quick, best = found
    assert np.all(np.isfinite(quick.exponents))
    assert same((quick.exponents, quick.stderr, quick.history), (best.exponents, best.stderr, best.history))


def test_better_code_follows_where_much_is_left_to_run(made):
    x = np.ones((40, 21))
    program = compiled(x)
    first = program(x)
    program.code.ahead(1e-6)
    finished()
    assert made == [0]
    program.code.ahead(1e6)
    program.code.ahead(1e6)
    finished()
    assert made == [0, 2]
    assert program.code.is_best
    assert same(first, program(x))


def test_better_code_follows_what_has_run_for_long(made, monkeypatch):
    """The second code first, and the third where it has run for longer."""
    x = np.ones((40, 21))
    program, expected = compiled(x), compiled(x)(x)
    made.clear()
    for costs, levels in (((1e3, 1e3), []), ((0.0, 1e3), [1]), ((0.0, 1e3), [1]), ((0.0, 0.0), [1, 2])):
        set_costs(program, *costs, monkeypatch)
        assert same(program(x), expected)
        finished()
        assert made == levels
    assert program.code.is_best
    assert same(program(x), expected)


def test_the_third_code_at_once_where_very_much_is_left(made, monkeypatch):
    x = np.ones((40, 21))
    for left, level in ((1.9, None), (2.1, 1), (59.0, 1), (61.0, 2)):  # 2 × 1 s, and 3 × 2 × 10 s
        program = compiled(x)
        set_costs(program, 1.0, 10.0, monkeypatch)
        made.clear()
        program.code.ahead(left)
        finished()
        assert made == ([] if level is None else [level])


def test_no_better_code_where_little_is_known_to_be_left(made, monkeypatch):
    x = np.ones((40, 21))
    program = compiled(x)
    program.code.ahead(1e-6)
    monkeypatch.setattr(program.code, "_spent", 1e6)
    program(x)
    finished()
    assert made == [0]


def test_better_code_follows_where_runs_are_repeated(made, monkeypatch):
    x = np.ones((40, 21))
    program = compiled(x)
    set_costs(program, 1.0, 10.0, monkeypatch)
    for spent, expected in ((1.4, [0]), (1.4, [0]), (0.8, [0]), (1.4, [0, 1]), (29.0, [0, 1]), (31.0, [0, 1, 2])):
        program(x)
        monkeypatch.setattr(program.code, "_spent", spent)
        program.code.ended()
        finished()
        assert made == expected


@pytest.mark.slow
def test_a_verb_that_is_called_again_and_again_gets_better_code(made, monkeypatch):
    problem, spectra = lh.zoo.lorenz63(), []
    _engines.forget_programs()
    monkeypatch.setattr(_engines, "_WORTH_A_COUNT", 0.0)
    monkeypatch.setattr(_tiers, "REPEATED", 0.0)
    monkeypatch.setattr(_tiers, "MIDDLE_SECONDS_A_LINE", 1.0)  # no other rule is met
    monkeypatch.setattr(_tiers, "SECONDS_A_LINE", 1.0)
    for _ in range(3):
        spectra.append(problem.spectrum(t1=2.0))
        finished()
        assert (2 in made) == (len(spectra) > 1)
    assert same(spectra[0].exponents, spectra[2].exponents)


def test_many_threads_may_run_it_meanwhile(made):
    x = np.random.default_rng(2).normal(size=(40, 21))
    program, wrong = compiled(x), []
    expected = program(x)

    def run():
        for _ in range(300):
            if not same(program(x), expected):
                wrong.append(1)

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    program.code.ahead(1e6)
    address = program.address("handler")  # waits for the best code
    for thread in threads:
        thread.join()
    assert not wrong
    assert address == program.address("handler")
    assert made == [0, 2]


def test_the_best_code_on_the_disk_is_taken_at_once(made, tmp_path, monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_CACHE", str(tmp_path))
    x = np.ones((40, 21))
    first = compiled(x)
    for left, levels in ((30.0, [0, 1]), (1e6, [0, 1, 2])):
        set_costs(first, 1.0, 10.0, monkeypatch)
        first.code.ahead(left)
        finished()
        again = compiled(x)
        assert made == levels
        assert again.code.is_best == first.code.is_best == (2 in levels)
        assert same(again(x), first(x))


def test_a_loop_that_is_one_call_is_optimised_before(made):
    def turns(n):
        return jax.lax.while_loop(lambda carry: carry[0] < n, lambda carry: (carry[0] + 1, carry[1] * 1.01), (0, 1.0))

    closed = jax.make_jaxpr(turns)(3)
    Compiled(closed)
    Compiled(closed, in_pieces=True)
    assert made == [2, 0]


def test_one_call_waits_for_loops_only_where_that_is_soon_done(made, monkeypatch):
    def turns(x):
        return jax.lax.while_loop(lambda x: x.sum() < 1e9, lambda x: jnp.sin(x) + x + jnp.cumsum(x)[::-1], x)

    x = np.random.default_rng(3).random(1000)
    closed = jax.make_jaxpr(turns)(x)
    best = Compiled(closed)
    monkeypatch.setattr(_tiers, "SECONDS_A_BLOCK", 1.0)
    plain, in_pieces = Compiled(closed), Compiled(closed, in_pieces=True)
    assert made == [2, 1, 0]
    assert best.code.is_best
    assert not plain.code.is_best
    expected = best(x)
    assert same(plain(x), expected)
    in_pieces.address("handler")  # one call within a jit
    assert made == [2, 1, 0, 1]
    assert not in_pieces.code.is_best
    assert same(in_pieces(x), expected)
    plain.code.ahead(1e6)
    finished()
    assert plain.code.is_best
    assert same(plain(x), expected)


@pytest.mark.slow
def test_no_call_waits_long_for_better_code(made):
    """A step whose numbers are written out one by one: LLVM takes seconds to optimise it."""

    def step(x):
        for _ in range(150):
            x = jnp.stack([jnp.sin(x[i - 1]) * x[i] + jnp.cos(x[i - 2]) for i in range(6)])
        return x

    def steps(x):
        return jax.lax.fori_loop(0, 400, lambda _, x: step(x), x)

    x = np.linspace(0.1, 0.6, 6)
    program = Compiled(jax.make_jaxpr(steps)(x))
    address = program.address("handler")  # within a jit, too
    assert made == [0]
    expected = program(x)
    program.code.ahead(1e6)
    finished()
    assert made == [0, 2]
    assert same(expected, program(x))
    assert program.address("handler") != address


@pytest.mark.slow
def test_a_long_run_gets_better_code(made, monkeypatch):
    problem = lh.zoo.lorenz63()
    _engines.forget_programs()
    problem.spectrum(t1=0.1, transient=0.1)
    finished()
    assert set(made) == {0}
    monkeypatch.setattr(_tiers, "SECONDS_A_LINE", 1e-7)
    monkeypatch.setattr(_tiers, "SECONDS_A_BLOCK", 1e-7)
    _engines.forget_programs()
    problem.spectrum(t1=3000.0, transient=0.1)
    finished()
    assert 2 in made


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lorenz63", "impact_oscillator"])  # at once in a vector register, one after another
def test_a_sweep_says_how_much_is_left(name, made, monkeypatch):
    problem = lh.zoo.get(name)()
    _engines.forget_programs()
    for rule in ("SECONDS_A_LINE", "SECONDS_A_BLOCK"):
        monkeypatch.setattr(_tiers, rule, 1e-7)
    monkeypatch.setattr(_tiers, "AT_LAST", np.inf)  # the rule where nobody says it
    (changed, value), *_ = problem.args.items()
    values = np.linspace(0.99, 1.0, 40) * float(value)
    lh.sweep(lambda args: problem.spectrum(args=args, t1=20.0), {changed: values}, args=problem.args, progress=False)
    finished()
    assert 2 in made


@pytest.mark.slow
def test_nobody_waits_for_the_code_of_another_process(made):
    """LLVM lets one thread of a process in at a time; a new program must not wait for the optimisation of another."""

    program, x = written_out(), np.linspace(0.1, 0.6, 6)
    program.code.ahead(1e6)
    assert np.allclose(Compiled(jax.make_jaxpr(jnp.sin)(x))(x)[0], np.sin(x))
    assert not program.code.is_best
    finished()
    assert program.code.is_best


@pytest.mark.parametrize(
    "command",
    [[], ["/nowhere/python"], [sys.executable, "-c", "raise SystemExit(1)"]],
    ids=["none", "no such", "fails"],
)
def test_without_another_process(command, made, monkeypatch):
    """Where a process cannot be begun the code is made here; where it fails, the first code stays."""
    begun = subprocess.Popen
    monkeypatch.setattr(sys, "executable", command[0] if command else "")
    monkeypatch.setattr(subprocess, "Popen", lambda _, **options: begun(command, **options))
    x = np.ones((40, 21))
    program = compiled(x)
    first = program(x)
    program.code.ahead(1e6)
    finished()
    assert program.code.is_best == ("-c" not in command)
    assert same(first, program(x))


@pytest.mark.slow
def test_a_module_that_is_taken_slowly_is_taken_whole(made, monkeypatch):
    """More than a pipe holds, read after some looks at whether it is still wanted."""
    begun = subprocess.Popen
    code = "import runpy, sys, time; time.sleep(0.5); del sys.argv[0]; runpy.run_path(sys.argv[0], run_name='__main__')"

    def slowly(command, **options):
        return begun([sys.executable, "-c", code, *command[2:]], **options)

    monkeypatch.setattr(subprocess, "Popen", slowly)
    program = written_out()
    assert len(program.text) > 2**17
    program.code.ahead(1e6)
    finished()
    assert program.code.is_best


@pytest.mark.slow
def test_an_optimisation_ends_with_python():
    """Python's end does not wait for an optimisation that takes seconds, and leaves no process behind."""
    code = """
import subprocess, time
import jax, jax.numpy as jnp, numpy as np
from lyaphybrid.native import Compiled
from lyaphybrid.native.machine import aside
begin = aside._begun
def told(*options):
    process = begin(*options)
    print(process.pid, flush=True)
    return process
aside._begun = told
def step(x):
    for _ in range(200):
        x = jnp.stack([jnp.sin(x[i - 1]) * x[i] + jnp.cos(x[i - 2]) for i in range(6)])
    return x
x = np.linspace(0.1, 0.6, 6)
program = Compiled(jax.make_jaxpr(lambda x: jax.lax.fori_loop(0, 10, lambda _, x: step(x), x))(x))
program.code.ahead(1e6)
time.sleep(0.5)
assert not program.code.is_best
"""
    begun = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True, text=True, check=True, timeout=60, env=os.environ | {"LYAPHYBRID_CACHE": "off"},
    )  # fmt: skip
    with pytest.raises(ProcessLookupError):
        os.kill(int(begun.stdout), 0)


def test_what_waits_for_its_turn_is_left_when_python_ends(made, monkeypatch):
    """Of several optimisations that were asked for, only the one under way holds up the end of a program."""
    program = compiled(np.ones((40, 21)))
    with _tiers._one_at_a_time:  # another optimisation is under way …
        program.code.ahead(1e9)
        monkeypatch.setattr(_tiers.threading.main_thread(), "is_alive", lambda: False)  # … when the program ends
    finished()
    assert made == [0]
    assert not program.code.is_best
