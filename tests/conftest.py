"""One setting for all tests: float64, nothing promoted silently, every warning an error (pyproject.toml)."""

import contextlib
import ctypes
import gc
import os
from pathlib import Path

import hypothesis
import jax
import matplotlib
import pytest
from matplotlib import pyplot

import before_jax  # noqa: F401  before anything that imports JAX
import references
from lyaphybrid._jax.engines import forget_programs

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
matplotlib.use("Agg")
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("fixed")

gc.set_threshold(100_000, 50, 50)  # many small objects, few cycles: tracing takes a fifth less time
CACHE_LIMIT = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 8  # bytes a process


def _resident_bytes() -> int:
    statm = Path("/proc/self/statm")  # Linux; elsewhere the caches stay
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if statm.exists() else 0


@pytest.fixture(autouse=True, scope="module")
def _bounded_caches():
    yield
    if _resident_bytes() > CACHE_LIMIT:
        forget_programs()
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # glibc keeps freed memory; others may have no such call
            ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(autouse=True)
def _no_figures_left():
    """A figure that a test leaves would be counted, or drawn in, by a later one of the same process."""
    yield
    pyplot.close("all")


@pytest.fixture(autouse=True, scope="module")
def _references_soon(request):
    """XLA's references for the compiler are run once or a few times: they need not be optimised.

    Elsewhere they are, for they round otherwise then, and orbits of chaotic maps are compared.
    """
    before, once = jax.config.read("jax_disable_most_optimizations"), request.path.parent.name == "native"
    jax.config.update("jax_disable_most_optimizations", once or before)
    yield
    jax.config.update("jax_disable_most_optimizations", before)


def pytest_sessionfinish():
    """What is no longer used is collected here; pytest would go through all that JAX keeps five times."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(config, items):
    """Cases of parametrised tests are slow by their ids: slow_cases("a", "b"), or slow_cases(all_but=("c", "d"))."""
    families = {}
    for item in items:
        if marker := item.get_closest_marker("slow_cases"):
            families.setdefault(item.nodeid.partition("[")[0], (marker, {}))[1][item.callspec.id] = item
    whole = not any("::" in argument for argument in config.args)  # or not all cases are collected
    for function, (marker, cases) in families.items():
        named = {*(marker.args or marker.kwargs["all_but"])}
        if whole and (unknown := named - cases.keys()):
            raise pytest.UsageError(f"{function}: slow_cases names {sorted(unknown)}; its cases are {sorted(cases)}.")
        for case in named & cases.keys() if marker.args else cases.keys() - named:
            cases[case].add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def automata() -> dict:
    return references.load_automata()


@pytest.fixture(scope="session")
def event_driven() -> dict:
    return references.load_event_driven()


@pytest.fixture(scope="session")
def nonsmooth() -> dict:
    return references.load_nonsmooth()


@pytest.fixture(scope="session")
def maps_and_flows() -> dict:
    return references.load_maps_and_flows()


@pytest.fixture(scope="session")
def gradients() -> dict:
    return references.load_gradients()
