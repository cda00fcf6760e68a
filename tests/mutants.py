"""Mutation testing: ``python -m tests.mutants [MODULE …] [--count 40] [--seed 1] [--jobs 2] [--out FILE]``.

A *mutant* is a module of the package with one small mistake: an operator, a constant, a condition or a call changed.
The tests named in `TESTS` run on a seeded sample of them, until one fails: then the mutant is killed. What survives is
a gap in the tests, or changes nothing that anybody could see; `tests/mutants.md` says which. The mutants of a module
are put into its place one after the other, in one process: most take less than a second. (POSIX only. Processes that
tests begin by themselves import the right module.)

Writes a line of JSON for each mutant. `--again FILE` repeats those that survived there, `--slow` runs slow tests, too.
"""

import argparse
import ast
import functools
import importlib.machinery
import importlib.util
import json
import os
import random
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests" / "support"))

import before_jax  # noqa: E402, F401  before anything that imports JAX

for name in "diffrax hypothesis.extra.numpy llvmlite.binding matplotlib.pyplot mpmath optax scipy.optimize".split():
    importlib.import_module(name)  # what the tests import, so that each process has it
import pytest  # noqa: E402

sys.dont_write_bytecode = False
LOOP = (
    "tests/engine/test_loop.py tests/engine/test_statuses.py tests/events/test_short_or_lost.py "
    "tests/engine/test_checkpoints.py"
)
NATIVE = "tests/native/test_memory_and_text.py tests/native/test_emission.py tests/native/test_each_primitive.py"
TESTS = {
    "events.compiled_hybrid": "tests/events/test_compiled_hybrid.py",
    "events.saltations": "tests/events/test_saltations.py",
    "events.roots": "tests/events/test_guards_in_a_step.py",
    "events.turns": "tests/events/test_turns.py tests/events/test_roots.py",
    "_linalg.frames": "tests/_linalg/test_lost_and_refilled.py tests/_linalg/test_frames.py",
    "engine.loop": LOOP,
    "engine.orthonormalising": f"tests/engine/test_orthonormalising.py tests/engine/test_scheduled_losses.py {LOOP}",
    **{f"native.lowering.{name}": NATIVE for name in ("emitter", "values")},
    "native.lowering.lowering": f"tests/native/test_lowering.py {NATIVE}",
    **{f"native.lowering.{name}": f"tests/native/test_costs_and_uses.py {NATIVE}" for name in ("costs", "uses")},
    **{
        f"native.rules.{name}": f"{NATIVE} tests/native/test_refusals.py tests/native/test_elementary.py"
        for name in ("control", "entrywise", "indexing", "moving", "reductions", "sorting")
    },
    "native.rules.branches": f"tests/native/test_lowering.py {NATIVE}",
    "native.rules.calls": f"tests/native/test_lowering.py tests/native/test_equinox.py {NATIVE}",
    "native.rules.gram_schmidt": "tests/_linalg/test_frames.py tests/native/test_linear_algebra.py",
    "native.rules.linear_algebra": f"tests/native/test_linear_algebra.py {NATIVE}",
    "native.rules.random_bits": "tests/native/test_random_bits.py",
}
IMPORTED_AGAIN = {
    "_linalg.frames",
    "events.compiled_hybrid",
    "native.lowering.lowering",
}  # their tests keep functions, compiled or not
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
NAMES = {"min": "max", "minimum": "maximum", "any": "all", "argmin": "argmax"}
NAMES |= {new: old for old, new in NAMES.items()}
ALREADY_IMPORTED = "ignore::pytest.PytestAssertRewriteWarning"
STRICT = "strict dropped"  # a change that is left out
CPU_SECONDS, MEMORY = 60, 12 * 2**30  # of one mutant, at most: more is killed


def alternatives(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:  # noqa: PLR0912  a table of cases
    """(what is changed, what stands there instead) for one node."""
    match node:
        case ast.Compare(left, operators, others):
            for i, old in enumerate(operators):
                for new in COMPARISONS[type(old)]:
                    changed = ast.Compare(left, [*operators[:i], new(), *operators[i + 1 :]], others)
                    yield f"{type(old).__name__} -> {new.__name__}", changed
        case ast.BinOp(left, old, right) if type(old) in OPERATORS:
            new = OPERATORS[type(old)]
            yield f"{type(old).__name__} -> {new.__name__}", ast.BinOp(left, new(), right)
        case ast.AugAssign(target, old, value) if type(old) in OPERATORS:
            new = OPERATORS[type(old)]
            yield f"{type(old).__name__} -> {new.__name__}", ast.AugAssign(target, new(), value)
        case ast.BoolOp(ast.And(), values):
            yield "and -> or", ast.BoolOp(ast.Or(), values)
        case ast.BoolOp(ast.Or(), values):
            yield "or -> and", ast.BoolOp(ast.And(), values)
        case ast.UnaryOp(old, operand):
            yield f"{type(old).__name__} dropped", operand
        case ast.IfExp(test, one, other):
            yield "sides of if exchanged", ast.IfExp(test, other, one)
        case ast.Constant(bool() as old):
            yield f"{old} -> {not old}", ast.Constant(not old)
        case ast.Constant(int() | float() as old):
            new = old + 1 if isinstance(old, int) else 2 * old or 1.0
            yield f"{old} -> {new}", ast.Constant(new)
        case ast.Call(ast.Attribute(_, "where") as function, [test, one, other]):
            yield "sides of where exchanged", ast.Call(function, [test, other, one], [])
        case ast.Call(ast.Attribute(value, name), arguments, keywords) if name in NAMES:
            yield (
                f"{name} -> {NAMES[name]}",
                ast.Call(ast.Attribute(value, NAMES[name], ast.Load()), arguments, keywords),
            )
        case ast.Call(ast.Name(name), arguments, keywords) if name in NAMES:
            yield f"{name} -> {NAMES[name]}", ast.Call(ast.Name(NAMES[name], ast.Load()), arguments, keywords)


class Change(ast.NodeTransformer):
    """Makes the change of this number in a tree, or none, and lists all: (line, what is changed)."""

    def __init__(self, number: int | None = None):
        self.number, self.all = number, []

    def visit(self, node):
        """Annotations, errors and assertions stay as they are."""
        if isinstance(node, ast.Raise | ast.Assert):
            return node
        if isinstance(node, ast.keyword) and node.arg == "strict":  # of `zip`: an assertion
            self.all.append((node.lineno, STRICT))
            return node
        chosen, found = node, list(self.found(node))
        for text, new in found:
            if len(self.all) == self.number:
                chosen = ast.copy_location(new, node)
            self.all.append((getattr(node, "lineno", 0), text))
        kept = {name: getattr(node, name) for name in ("annotation", "returns") if hasattr(node, name)}
        for name in kept:
            setattr(node, name, None)
        self.generic_visit(node)
        for name, value in kept.items():
            setattr(node, name, value)
        return chosen

    def found(self, node):
        """The alternatives of a node; conditions are negated, and calls that stand alone are dropped."""
        yield from alternatives(node)
        if isinstance(node, ast.If | ast.While):
            whole = {name: getattr(node, name) for name in node._fields}
            yield "condition negated", type(node)(**whole | {"test": ast.UnaryOp(ast.Not(), node.test)})
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield "call dropped", ast.Pass()


def path_of(module: str) -> Path:
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


@functools.cache
def source(module: str) -> str:
    """The text of a module as it is when this program begins: it may be edited meanwhile."""
    return path_of(module).read_text()


@functools.cache
def changes(module: str) -> list[tuple[int, str]]:
    """(line, what is changed) of all mutants of a module."""
    change = Change()
    change.visit(ast.parse(source(module)))
    return change.all


@functools.cache
def first_seen(module: str) -> dict[str, tuple]:
    """What each name of a module is without a mistake, and the other modules that have it by the same name."""
    others = [one for key, one in sys.modules.items() if key.startswith("lyaphybrid.") and key != module]
    return {
        name: (value, [other for other in others if vars(other).get(name) is value])
        for name, value in vars(importlib.import_module(module)).items()
    }


def put_in_place(module: str, number: int) -> None:
    """Run the module with one change in its own namespace. Its classes stay what they are, with the new methods."""
    place, known = importlib.import_module(module), first_seen(module)
    tree = Change(number).visit(ast.parse(source(module)))
    exec(compile(ast.fix_missing_locations(tree), str(path_of(module)), "exec"), vars(place))
    for name, (old, others) in known.items():
        new = vars(place)[name]
        if isinstance(old, type) and old.__module__ == module:
            _renew(old, new)
            setattr(place, name, old)
        elif isinstance(old, dict | set) and old and not new:  # what other modules have filled
            setattr(place, name, old)
        elif new is not old:
            for other in others:
                setattr(other, name, new)


def _renew(old: type, new: type) -> None:
    """Give a class the attributes of another."""
    for name, value in vars(new).items():
        for cell in getattr(value, "__closure__", None) or ():
            if cell.cell_contents is new:  # what `super()` looks at
                cell.cell_contents = old
        if name not in ("__dict__", "__weakref__"):
            setattr(old, name, value)


def test(module: str, number: int | None, which: str) -> int:
    """The exit status of the tests of a module with one change; what they import of the package is there already."""
    files = TESTS[module.removeprefix("lyaphybrid.")].split()
    try:
        if number is not None:
            put_in_place(module, number)
            importlib.import_module("lyaphybrid._jax.engines").forget_programs()
        if module.removeprefix("lyaphybrid.") in IMPORTED_AGAIN:
            for file in files:
                sys.modules.pop(Path(file).stem, None)
        options = "-o addopts= -q -x -rf -p no:cacheprovider -p no:xdist --tb=line -W".split()
        return int(pytest.main([*options, ALREADY_IMPORTED, "-m", which, *files]))
    except BaseException:
        traceback.print_exc()
        return 1


def said(file, module: str, number: int | None, status: int, printed: str, seconds: float) -> None:
    """Write a line of results."""
    failed = [line for line in printed.splitlines() if line.startswith(("FAILED", "ERROR", "E  "))]
    line, text = (0, "nothing") if number is None else changes(module)[number]
    about = {"module": module, "number": number, "line": line, "change": text, "killed": status != 0}
    why = printed[-3000:] if number is None and status else "".join(failed[-1:])[:150]
    file.write(json.dumps(about | {"status": status, "by": why, "seconds": round(seconds, 1)}) + "\n")
    file.flush()


def begin(module: str, numbers: list[int | None], which: str, file, done) -> int:
    """Begin to test these mutants in a process of their own, whose number is returned; it says how many are done."""
    if child := os.fork():
        return child
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    for number in numbers:
        before = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(before) + CPU_SECONDS, resource.RLIM_INFINITY))
        with tempfile.TemporaryFile("w+") as output:
            for stream in (1, 2):
                os.dup2(output.fileno(), stream)
            status = test(module, number, which)
            sys.stdout.flush()
            output.seek(0)
            said(file, module, number, status, output.read(), time.process_time() - before)
        if number is None and status:
            os._exit(1)
        os.write(done, b".")
    os._exit(0)


def results(wanted: dict[str, list[int]], jobs: int, which: str, file) -> None:
    """Test these mutants of each module, first the module as it is; so many processes at once."""
    waiting, running = [(module, [None, *numbers]) for module, numbers in wanted.items()], {}
    while running or waiting:
        while waiting and len(running) < jobs:
            module, numbers = waiting.pop(0)
            done, end = os.pipe()
            running[begin(module, numbers, which, file, end)] = module, numbers, done
            os.close(end)
        process, status = os.wait()
        module, numbers, done = running.pop(process)
        rest = numbers[len(os.read(done, len(numbers))) :]
        os.close(done)
        if rest and rest[0] is None:
            raise SystemExit(f"The tests of {module} fail without a mistake, see {file.name}.")
        if rest:  # the first of these took too long, or it crashed
            said(file, module, rest[0], status, "", CPU_SECONDS)
            waiting.append((module, rest[1:]))


def main() -> int:
    """Test a sample of the mutants of each module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=[*TESTS], help=f"of {', '.join(TESTS)}")
    parser.add_argument("--count", type=int, default=40, help="mutants of each module (40)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants.jsonl")
    parser.add_argument("--slow", action="store_true", help="run slow tests, too")
    parser.add_argument("--again", type=Path, help="only the mutants that survived in this file")
    given = parser.parse_args()
    wanted = {}
    for module in [f"lyaphybrid.{name}" for name in given.modules]:
        numbers = range(len(changes(module)))
        wanted[module] = random.Random(given.seed).sample(numbers, len(numbers))[: given.count]
    if given.again:
        before = [json.loads(line) for line in given.again.read_text().splitlines()]
        wanted = {module: [] for module in wanted}
        for one in before:
            if one["number"] is not None and not one["killed"] and one["module"] in wanted:
                wanted[one["module"]].append(one["number"])
    wanted = {module: [i for i in some if changes(module)[i][1] != STRICT] for module, some in wanted.items()}
    given.out.parent.mkdir(exist_ok=True)
    with given.out.open("a") as file:
        results(wanted, given.jobs, "slow or not slow" if given.slow else "not slow", file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
