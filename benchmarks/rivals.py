"""Other implementations in JAX, at the same tolerances and with the same QR schedule of orthonormalisation."""

import importlib.util
import pathlib
import sys

import jax

from benchmarks import problems
from benchmarks.harness import Run

jax.config.update("jax_enable_x64", True)

SECOND_IMPLEMENTATION = pathlib.Path(__file__).parent.parent / "tests" / "support" / "diffrax_events.py"
SEGMENTS = 1024  # flights in one compiled call


def _load(path: pathlib.Path):
    """A module of the tests, which are no package."""
    if path.stem not in sys.modules:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[path.stem] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[path.stem])
    return sys.modules[path.stem]


def second_implementation():
    """The module of the tests that finds events by diffrax."""
    return _load(SECOND_IMPLEMENTATION)


def diffrax_events(field, guard, reset, t1: float) -> Run:
    """The impact oscillator by an outer `lax.scan` over `diffrax.diffeqsolve(event=…)`, Dormand–Prince 5(4)."""
    second = second_implementation()
    options = second.Options(problems.IMPACT_RTOL, problems.IMPACT_ATOL, segments_per_call=SEGMENTS)
    start, args = problems.IMPACT_START, problems.IMPACT_PARAMETERS

    def run():
        keywords = {"t1": t1, "longest": problems.IMPACT_EVERY_EVENT, "options": options}
        found = second.diffrax_spectrum(field, guard, reset, start, args, **keywords)
        return {"exponents": sorted(found.exponents.tolist(), reverse=True), "events": len(found.t)}

    return run
