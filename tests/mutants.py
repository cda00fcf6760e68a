"""Mutation testing: ``python -m tests.mutants [MODULE …] [--count 40] [--seed 1] [--jobs 2] [--out FILE]``.

A *mutant* is a module of the package with one small mistake: an operator, a constant, a condition or a call changed.
The tests named in `TESTS` run on a seeded sample of them, until one fails: then the mutant is killed. What survives is
a gap in the tests, or changes nothing that anybody could see; `tests/mutants.md` says which. Each mutant has a process,
forked when all that the tests need except the package is imported. (POSIX only. Processes that tests begin by
themselves import the right module.)

Writes a line of JSON for each mutant. `--again FILE` repeats those that survived there, `--show` prints the mutants.
"""

import argparse
import ast
import importlib.machinery
import importlib.util
import json
import os
import random
import resource
import signal
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
LOOP = "tests/engine/test_statuses.py tests/engine/test_checkpoints.py tests/events/test_short_or_lost.py"
NATIVE = "tests/native/test_emission.py tests/native/test_each_primitive.py"
TESTS = {
    "events.saltations": "tests/events/test_saltations.py",
    "events.roots": "tests/events/test_guards_in_a_step.py",
    "events.turns": "tests/events/test_turns.py tests/events/test_roots.py",
    "_linalg.frames": "tests/_linalg/test_frames.py",
    "engine.loop": LOOP,
    **{f"native.lowering.{name}": NATIVE for name in ("costs", "emitter", "lowering", "uses", "values")},
    **{
        f"native.rules.{name}": NATIVE
        for name in ("branches", "control", "entrywise", "indexing", "moving", "reductions")
    },
}
ALONE = {"events.saltations", "events.roots", "events.turns", "_linalg.frames"}  # tested through the module itself
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
CPU_SECONDS, WALL_SECONDS, MEMORY = 120, 1500, 12 * 2**30  # of one mutant, at most: more is killed


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


class Mutated(importlib.machinery.SourceFileLoader):
    """Loads one module with one change; as a finder it is asked before the others."""

    def __init__(self, module: str, number: int | None):
        super().__init__(module, str(path_of(module)))
        self.number = number

    def find_spec(self, name, path=None, target=None):
        del path, target
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, fullname):
        tree = Change(self.number).visit(ast.parse(self.get_data(self.path), self.path))
        return compile(ast.fix_missing_locations(tree), self.path, "exec")


def path_of(module: str) -> Path:
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


def changes(module: str) -> list[tuple[int, str]]:
    """(line, what is changed) of all mutants of a module."""
    change = Change()
    change.visit(ast.parse(path_of(module).read_text()))
    return change.all


def run(module: str) -> int:
    """The exit status of the tests of a module; what they import is imported anew."""
    files = TESTS[module.removeprefix("lyaphybrid.")].split()
    for file in files:
        sys.modules.pop(Path(file).stem, None)
    options = "-o addopts= -q -x -rf -p no:cacheprovider -p no:xdist --tb=line -W".split()
    return int(pytest.main([*options, ALREADY_IMPORTED, "-m", "not slow", *files]))


def tested(module: str, number: int | None, apart: bool) -> int:
    """The status of the tests with one change: it is made while the module is imported, or in the module as it is."""
    try:
        if apart:
            sys.meta_path.insert(0, Mutated(module, number))
        elif number is not None:
            exec(Mutated(module, number).get_code(module), vars(importlib.import_module(module)))
        signal.setitimer(signal.ITIMER_VIRTUAL, 0 if apart else CPU_SECONDS)
        return run(module)
    except BaseException:
        traceback.print_exc()
        return 1


def stopped(*_):
    raise KeyboardInterrupt("too long")


def begin(module: str, numbers: list[int | None], apart: bool, file) -> int:
    """Begin to test these mutants in a process of their own, whose number is returned."""
    if child := os.fork():
        return child
    limits = {resource.RLIMIT_DATA: MEMORY} | ({resource.RLIMIT_CPU: CPU_SECONDS} if apart else {})
    for kind, limit in limits.items():
        resource.setrlimit(kind, (limit, limit))
    signal.signal(signal.SIGVTALRM, stopped)
    for number in numbers:
        with tempfile.TemporaryFile("w+") as output:
            for stream in (1, 2):
                os.dup2(output.fileno(), stream)
            status = tested(module, number, apart)
            sys.stdout.flush()
            output.seek(0)
            printed = output.read()
        said(file, module, number, status, printed)
    os._exit(0)


def said(file, module: str, number: int | None, status: int, printed: str) -> None:
    """Write a line of results."""
    failed = [line for line in printed.splitlines() if line.startswith(("FAILED", "ERROR", "E  "))]
    line, text = (0, "nothing") if number is None else changes(module)[number]
    about = {"module": module, "number": number, "line": line, "change": text, "killed": status != 0}
    why = printed[-3000:] if number is None and status else "".join(failed[-1:])[:150]
    file.write(json.dumps(about | {"status": status, "by": why, "seconds": round(time.process_time(), 1)}) + "\n")
    file.flush()


def results(wanted: dict[str, list[int | None]], jobs: int, file) -> None:
    """Test these mutants of each module, first the module as it is; so many processes at once."""
    waiting, running = [], {}
    for module, numbers in wanted.items():
        alone = module.removeprefix("lyaphybrid.") in ALONE
        waiting += [(module, [None, *numbers], False)] if alone else [(module, [i], True) for i in [None, *numbers]]
    while running or waiting:
        while waiting and len(running) < jobs:
            module, numbers, apart = waiting.pop(0)
            running[begin(module, numbers, apart, file)] = module, numbers
        process, status = os.wait()
        module, numbers = running.pop(process)
        if status:  # ended from outside: too long, too large, or it crashed
            said(file, module, numbers[0], status, "")


def main() -> int:
    """Test a sample of the mutants of each module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=[*TESTS], help=f"of {', '.join(TESTS)}")
    parser.add_argument("--count", type=int, default=40, help="mutants of each module (40)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants.jsonl")
    parser.add_argument("--again", type=Path, help="only the mutants that survived in this file")
    given = parser.parse_args()
    wanted = {}
    for module in [f"lyaphybrid.{name}" for name in given.modules]:
        numbers = range(len(changes(module)))
        wanted[module] = random.Random(given.seed).sample(numbers, min(given.count, len(numbers)))
    if given.again:
        before = [json.loads(line) for line in given.again.read_text().splitlines()]
        wanted = {module: [] for module in wanted}
        for one in before:
            if one["number"] is not None and not one["killed"] and one["module"] in wanted:
                wanted[one["module"]].append(one["number"])
    given.out.parent.mkdir(exist_ok=True)
    with given.out.open("a") as file:
        results(wanted, given.jobs, file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
