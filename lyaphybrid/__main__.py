"""The command line: `lyaphybrid`, and its commands `list`, `spectrum`, `sweep`, `reference`, `validate`, `papers`.

Exit status: 0 success, 1 a run or a check failed, 2 wrong arguments, 130 interrupted by Ctrl-C.
"""

import argparse
import ast
import atexit
import contextlib
import functools
import gc
import inspect
import json
import math
import os
import sys
from collections.abc import Sequence
from typing import Any

from ._options import parser_of

WORKED, FAILED, ASKED_WRONG, INTERRUPTED = 0, 1, 2, 130
LINES = 40  # a sweep of more points is printed as a summary


class RefusedError(Exception):
    """Wrong arguments of the command; the message says which ones are possible."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    Args:
        argv: the arguments; None: those of the process.

    Example:
        >>> from lyaphybrid.__main__ import main
        >>> main(["papers", "dinious"])
        2
    """
    try:
        options = _parser().parse_args(sys.argv[1:] if argv is None else list(argv))
    except SystemExit as end:  # argparse has already printed the help, the version or the error
        return int(end.code or 0)
    _set_up()
    try:
        return options.run(options)
    except RefusedError as refused:
        print(f"lyaphybrid: {refused}", file=sys.stderr)
        return ASKED_WRONG
    except KeyboardInterrupt:
        print("lyaphybrid: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # who reads, as `head` does, has enough; Python would write once more when it ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return WORKED


def _set_up() -> None:
    """Compute in float64: JAX must be told before it makes the first array. And end at once."""
    import jax

    jax.config.update("jax_enable_x64", True)
    gc.freeze()  # modules stay: Python need not look for garbage among a million objects again and again
    atexit.register(gc.freeze)  # or Python looks for garbage once more before it ends, among a million objects


def _parser() -> argparse.ArgumentParser:
    runs = {"list": _list, "spectrum": _spectrum, "sweep": _sweep, "reference": _reference}
    return parser_of({**runs, "validate": _validate, "papers": _papers})


def _list(options) -> int:
    from . import zoo

    width = max(map(len, zoo.names()))
    for name in zoo.names():
        build = zoo.get(name)
        summary = inspect.cleandoc(build.__doc__ or "").splitlines()[0].rstrip(".")
        reference = build().reference
        print(f"{name:<{width}}  {summary}.")
        print(f"{'':<{width}}  reference: {reference if reference is not None else 'none'}")
    return WORKED


def _spectrum(options) -> int:
    from .statuses import STATUS

    problem = _problem(options)
    overrides = _overrides(options, problem)
    try:
        with _progress(options, problem.name) as progress:
            spectrum = problem.spectrum(throw=False, progress=progress, **overrides)
    except ValueError as error:
        raise RefusedError(str(error)) from error
    status = spectrum.status
    assert isinstance(status, STATUS)
    if options.json:
        print(json.dumps(_as_json(problem, spectrum, overrides), allow_nan=False))
    else:
        parameters = ", ".join(f"{key}={_as_json_value(value)}" for key, value in problem.parameters.items())
        print(f"{problem.name}({parameters})")
        print(spectrum)
        print(f"  reference {problem.reference or 'none for these parameters'}")
    if status.failed:
        print(f"lyaphybrid: {status}", file=sys.stderr)
        return FAILED
    return INTERRUPTED if "interrupted" in spectrum.notes else WORKED


def _sweep(options) -> int:
    from .sweeps import StoreFailedError, sweep

    problem = _problem(options)
    if not options.over:
        raise RefusedError(
            f"Nothing to sweep: give --over KEY=LOW:HIGH:COUNT; KEY is one of {', '.join(problem.parameters)}."
        )
    axes = [_axis(text, problem) for text in options.over]
    over = dict(axes)
    if twice := [key for key in over if [name for name, _ in axes].count(key) > 1]:
        raise RefusedError(f"--over names {twice[0]} twice: give one axis for each parameter.")
    if both := [key for key in over if key in {setting.partition("=")[0] for setting in options.set}]:
        raise RefusedError(f"{both[0]} is an axis of the sweep, --over, and cannot have one value by --set as well.")
    if options.resume and options.store is None:
        raise RefusedError("--resume goes on with a store: give its folder, --store FOLDER.")
    fixed = {name: value for name, value in problem.parameters.items() if name not in over}
    overrides = _overrides(options, problem)
    if options.store is not None and options.store.exists() and not options.resume:
        raise RefusedError(f"{options.store} is there: --resume goes on with it, another --store begins anew.")

    def run(swept):
        return _builder(problem.name)(**fixed, **swept).spectrum(throw=False, **overrides)

    with contextlib.ExitStack() as stack:
        try:
            client = None if options.workers is None else stack.enter_context(_cluster(options.workers))
            progress = stack.enter_context(_progress(options, problem.name))
            args = {name: 0.0 for name in over}
            found = sweep(
                run, over, args=args, chunk=options.chunk, store=options.store, client=client, progress=progress
            )
        except (ValueError, ImportError) as error:
            raise RefusedError(str(error)) from error
        except StoreFailedError as error:
            print(f"lyaphybrid: {error}", file=sys.stderr)
            return FAILED
    return _print_points(found, over)


def _axis(text: str, problem) -> tuple[str, Any]:
    """KEY=LOW:HIGH:COUNT as a name and its values."""
    import numpy as np

    key, equals, numbers = text.partition("=")
    parts = [_literal(part) for part in numbers.split(":")]
    good = equals and len(parts) == 3 and isinstance(parts[2], int) and parts[2] > 0
    if not good or not all(isinstance(part, int | float) for part in parts):
        raise RefusedError(f"--over takes KEY=LOW:HIGH:COUNT, beta=0:0.3:151; got {text!r}.")
    if not isinstance(problem.parameters.get(key), float):
        known = ", ".join(name for name, value in problem.parameters.items() if isinstance(value, float))
        raise RefusedError(f"{problem.name} has no parameter {key!r} that can be swept; it has {known or 'none'}.")
    return key, np.linspace(float(parts[0]), float(parts[1]), parts[2])


def _cluster(workers: int):
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise RefusedError("--workers needs dask and distributed: pip install 'lyaphybrid[cluster]'.") from error
    return Client(LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0"))


def _print_points(found, over: dict[str, Any]) -> int:
    """Print one line for each point; for more than LINES points only the range of λ1."""
    import numpy as np

    from .statuses import STATUS

    names, status = list(over), found.status.values.ravel()
    exponents = found.exponents.values.reshape(len(status), -1)
    if len(status) <= LINES:
        grids = np.meshgrid(*over.values(), indexing="ij")
        for point, row in enumerate(exponents):
            place = ", ".join(f"{name}={grid.ravel()[point]:.6g}" for name, grid in zip(names, grids, strict=True))
            verdict = STATUS(int(status[point])).name if status[point] >= 0 else "not computed"
            print(f"{place}  {' '.join(f'{value: .6g}' for value in row)}  {verdict}")
    elif np.any(np.isfinite(exponents)):
        print(f"λ1 from {np.nanmin(exponents[:, 0]):.6g} to {np.nanmax(exponents[:, 0]):.6g}")
    print(f"{len(status)} points in {found.attrs['seconds']:.3g} s: {found.attrs['outcome']}")
    return WORKED if np.all(status >= 0) else INTERRUPTED


def _progress(options, name: str):
    """A context that gives a function to call with the fraction done; None where no progress is wanted."""
    from .engine.host.reporting import line_of_progress

    wanted = sys.stderr.isatty() if options.progress is None else options.progress
    return line_of_progress(name, sys.stderr) if wanted else contextlib.nullcontext()


def _problem(options):
    """The named problem with its parameters; an error lists the possible names."""
    import jax

    parameters = {}
    for setting in options.set:
        key, equals, value = setting.partition("=")
        if not equals or not key:
            raise RefusedError(f"--set takes KEY=VALUE; got {setting!r}.")
        parameters[key] = _literal(value)
    try:
        build = _builder(options.name)
        if "key" in parameters:
            raise RefusedError("Random starts are chosen by --seed, not by --set key=….")
        if "key" in inspect.signature(build).parameters:
            parameters["key"] = jax.random.key(options.seed)
        return build(**parameters)
    except ValueError as error:
        raise RefusedError(str(error)) from error


def _builder(name: str):
    """The function of the problem, or of the published flow, that has this name."""
    from . import zoo

    return functools.partial(zoo.flow, name) if name not in zoo.names() and name in zoo.flow_names() else zoo.get(name)


def _literal(text: str) -> Any:
    """A Python literal (number, True, None, tuple), or the text itself."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        try:
            return float(text)  # inf and nan: the problem itself checks them
        except ValueError:
            return text


def _overrides(options, problem) -> dict[str, Any]:
    """Arguments of `problem.spectrum` that were given as options."""
    import jax

    names = ("t1", "transient", "k", "replicates", "every", "max_steps")
    overrides = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if options.replicates is not None:
        overrides["key"] = jax.random.key(options.seed)
    tolerances = {name: getattr(options, name) for name in ("rtol", "atol")}
    tolerances = {name: value for name, value in tolerances.items() if value is not None}
    if tolerances:
        overrides["method"] = _method(problem, tolerances)
    return overrides


def _method(problem, tolerances: dict[str, float]):
    """The problem's method with other tolerances."""
    import equinox as eqx

    from .integrators import RungeKutta
    from .systems.event_driven import EventDriven
    from .systems.kinds import iterates

    system = problem.system
    if isinstance(system, EventDriven) or iterates(system):
        kind = "is exact" if isinstance(system, EventDriven) else "is a map"
        raise RefusedError(f"{problem.name} {kind}: there is no tolerance to set.")
    for name, value in tolerances.items():
        if not 0 < value < math.inf:
            raise RefusedError(f"--{name} must be positive and finite; got {value!r}.")
    method = RungeKutta() if problem.method is None else problem.method
    if not method.adaptive:
        raise RefusedError(f"{problem.name} is integrated with a fixed step: there is no tolerance to set.")
    names = tuple(tolerances)
    return eqx.tree_at(lambda m: [getattr(m, name) for name in names], method, list(tolerances.values()))


def _as_json(problem, spectrum, overrides: dict[str, Any]) -> dict[str, Any]:
    """The JSON object that `--json` prints; −inf becomes "-inf", nan becomes null."""
    import numpy as np

    reference, jumps = problem.reference, float(np.mean(np.asarray(spectrum.jumps)))
    return {
        "name": problem.name,
        "parameters": {key: _as_json_value(value) for key, value in problem.parameters.items()},
        "exponents": _as_json_value(np.asarray(spectrum.exponents).tolist()),
        "stderr": _as_json_value(np.asarray(spectrum.stderr).tolist()),
        "error_kind": spectrum.error_kind,
        "t1": float(overrides.get("t1", problem.t1)),
        "jumps": int(jumps) if jumps.is_integer() else jumps,
        "status": spectrum.status.name,
        "notes": sorted(spectrum.notes),
        "reference": None
        if reference is None
        else {
            "exponents": _as_json_value(list(reference.exponents)),
            "stderr": _as_json_value(list(reference.stderr)),
            "exact": reference.exact,
            "clock": reference.clock,
            "source": reference.source,
        },
    }


def _as_json_value(value: Any) -> Any:
    """The value as JSON can hold it."""
    match value:
        case None | bool() | int() | str():
            return value
        case list() | tuple():
            return [_as_json_value(v) for v in value]
        case float():
            if math.isnan(value):
                return None
            return value if math.isfinite(value) else ("-inf" if value < 0 else "inf")
    return str(value)


def _reference(options) -> int:
    from .zoo.published.accounts import account, as_data, summary
    from .zoo.published.spectra import recorded

    try:
        if options.json:
            found = as_data(options.name) if options.name else {name: as_data(name) for name in recorded()}
            print(json.dumps(found, ensure_ascii=False, allow_nan=False))
        else:
            print(account(options.name) if options.name else "\n".join(map(summary, recorded())))
    except ValueError as error:
        raise RefusedError(str(error)) from error
    return WORKED


def _validate(options) -> int:
    from . import zoo
    from .zoo import reference_checks

    try:
        found = []
        for one in reference_checks.comparisons(options.names or zoo.names(), options.quick):
            off = "" if one.has_reference else " from the first way, for there is no reference"
            found.append(one)
            verdict = "agrees" if one.agrees else "MISSES"
            print(
                f"{verdict}  {one.problem:<22} {one.way:<28} {one.deviation:5.1f} standard errors{off}, {one.status}, "
                f"{one.seconds:.1f} s",
                flush=True,
            )
    except ValueError as error:
        raise RefusedError(str(error)) from error
    missed = sum(not one.agrees for one in found)
    print(f"{len(found)} runs of {len({one.problem for one in found})} problems, {missed} missed")
    if options.out is not None:
        rows = [{name: _as_json_value(value) for name, value in one._asdict().items()} for one in found]
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        print(f"wrote {options.out}")
    return FAILED if missed else WORKED


def _papers(options) -> int:
    from . import papers

    try:
        paper = papers.get(options.paper)
    except ValueError as error:
        raise RefusedError(str(error)) from error
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedError(f"The folder {options.out} cannot be made: {error.strerror}.") from error
    with _progress(options, options.paper) as progress:
        result = paper.reproduce(quick=options.quick, progress=progress)
    print(result)
    for file in paper.write(result, options.out):
        print(f"wrote {file}")
    return WORKED if result.passed else FAILED


if __name__ == "__main__":
    sys.exit(main())
