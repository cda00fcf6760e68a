"""Random cases of each kind: a few dozen in the fast suite, more than 5000 in the slow one."""

import jax.numpy as jnp
import pytest

import lyaphybrid as lh
from fuzz import arguments
from fuzz.kinds import KINDS

FAST = {"arguments": 120, "automata": 50, "calls": 3, "daes": 50, "hamiltonians": 50, "resets": 50}  # seeds, from 0
SLOW = {"arguments": 2500, "automata": 1500, "calls": 120, "daes": 1500, "hamiltonians": 1500, "resets": 1500}


@pytest.fixture(autouse=True)
def _what_only_xla_compiles(monkeypatch):
    """Hostile arguments may ask for it."""
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_random_cases(kind):
    assert KINDS[kind](range(FAST[kind])) == {}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_random_cases(kind):
    assert KINDS[kind](range(FAST[kind], SLOW[kind])) == {}


# What counts as wrong: the judge can say no.


def test_an_error_that_names_nothing_is_wrong(monkeypatch):
    def verb(x0):
        return float(x0)

    monkeypatch.setitem(arguments.CALLS, "broken", (verb, None, {"x0": 1.0}))
    assert "names nothing" in arguments.verdict("broken", {"x0": "text"})
    assert "TypeError" in arguments.verdict("broken", {"x0": "empty list"})
    assert arguments.verdict("broken", {"x0": "0.5"}) is None


def test_nan_with_the_status_ok_is_wrong(monkeypatch):
    def verb(x0):
        return lh.tangent_map(arguments.DAMPED, [0.1, 0.2], 0.3, t1=1.0).__class__(*[jnp.asarray(x0)] * 3, 0, 0)

    monkeypatch.setitem(arguments.CALLS, "broken", (verb, None, {"x0": 1.0}))
    assert arguments.verdict("broken", {"x0": "nan"}) == "nan with the status ok"
