"""Hostile systems answer soon; and what is only long, or slow, is left alone."""

import re
import signal

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from hostile import CIRCLE, FRICTION, HOSTILE, MOD, STIFF, WHERE, answer
from lyaphybrid import STATUS
from lyaphybrid.engine import waiting
from lyaphybrid.engine.host.paces import ATTEMPTS_BETWEEN_CHECKS, ATTEMPTS_EXAMINED, ATTEMPTS_STOPPED, Pace, Rates

SECONDS = 20  # of a processor


@pytest.fixture
def limited():
    """An error where a test takes too long; Ctrl-C would only end the run within."""

    def late(*_):
        raise TimeoutError(f"no answer within {SECONDS} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    yield
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.signal(signal.SIGPROF, before)


@pytest.mark.slow_cases(
    "relay by sign",
    "guard by mod",
    "guard by floor",
    "stiff",
    "chattering",
    "section never crossed",
    "jumps that do not come",
    "dice",
    "guard never zero",
    "friction by sign",
    "huge rate",
    "reset onto the guard",
    "bouncing to rest",
    "guard always zero",
    "guard that is touched",
)
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_systems_answer(name, limited, monkeypatch):
    if name == "dice":  # Python is called within the loop: XLA runs that
        monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")
    said = answer(name)
    assert re.search(HOSTILE[name][1], said), said
    assert "t = nan" not in said


def stalled(system, x0, **options):
    with pytest.raises(lh.RunFailedError) as caught:
        lh.lyapunov_spectrum(system, x0, t1=1e4, **options)
    assert caught.value.status is STATUS.stalled
    return str(caught.value)


@pytest.mark.slow
def test_the_message_says_where_and_why(limited):
    assert re.search(r"t = 3\.34\d*, x = \[0\.01\d* 0\.1\].* h = \d.*not smooth here", stalled(FRICTION, [1.0, 0.0]))
    assert re.search(r"t = 0\.9\d*, x = \[1 1\.1\].*not smooth here", stalled(MOD, [0.1, 0.2]))
    assert re.search(r"stiff here, ‖Df‖ = 1e\+09: use lh\.RadauIIA", stalled(STIFF, [1.0, 1.0]))
    assert "unit of the system's time" in stalled(lh.Flow(lambda t, x, a: 1e12 * CIRCLE.field(t, x, a)), [1.0, 0.0])


def test_who_gives_max_steps_decides_alone(limited):
    spectrum = lh.lyapunov_spectrum(WHERE, [1.0, 1.0], t1=1e4, max_steps=3_000_000, throw=False)
    assert spectrum.status is STATUS.max_steps


@pytest.mark.slow
def test_of_several_runs_only_those_end_that_have_stalled(limited):
    """Where the second component is zero nothing moves, and the run reaches its end."""
    sliding = lh.Flow(lambda t, x, args: x[1] * WHERE.field(t, x, args))
    spectrum = lh.lyapunov_spectrum(sliding, [[1.0, 1.0], [1.0, 0.0]], t1=1e4, throw=False)
    assert np.asarray(spectrum.status_code).tolist() == [STATUS.stalled, STATUS.ok]
    assert spectrum.status is STATUS.stalled
    assert float(spectrum.t[1]) == pytest.approx(1e4, rel=1e-12)


class _Standing:
    """As much of a loop's state as a pace looks at."""

    def __init__(self, time, jumps=0, h=0.1):
        self.elapsed, self.carry = np.float64(time), self
        self.s, self.jumps, self.status, self.solver_state, self.h = (
            np.float64(0),
            np.int32(jumps),
            np.int32(0),
            self,
            h,
        )


def judged(moved, end, rates=None, jumped=0, last_jump=None, windows=1):
    """What is said after windows of attempts, in each of which so much was done."""
    pace = Pace(_Standing(0.0), 0, np.inf if end is None else end, last_jump or 0, last_jump is not None)
    for window in range(1, windows + 1):
        found = pace.look(
            _Standing(moved * window, jumped * window), window * ATTEMPTS_BETWEEN_CHECKS, lambda run: rates
        )
        if found:
            return found[0]
    return ""


def test_long_runs_are_left_alone():
    smooth, stiff, rough = Rates(1.0, 1.0), Rates(1e6, 1.0), Rates(1.0, 1.0)
    assert not judged(
        0.1 * ATTEMPTS_BETWEEN_CHECKS, 0.1 * ATTEMPTS_STOPPED / 2, smooth
    )  # a run of half the longest that makes sense
    assert "unit" in judged(0.1 * ATTEMPTS_BETWEEN_CHECKS, 0.1 * ATTEMPTS_STOPPED * 2, smooth)
    assert not judged(1e-6 * ATTEMPTS_BETWEEN_CHECKS, 1e-6 * ATTEMPTS_EXAMINED / 2, stiff)  # slow, but it will end
    assert "stiff" in judged(1e-6 * ATTEMPTS_BETWEEN_CHECKS, 1e-6 * ATTEMPTS_EXAMINED * 2, stiff)
    assert not judged(1e-9 * ATTEMPTS_BETWEEN_CHECKS, 1e-9 * ATTEMPTS_EXAMINED / 2, rough)
    assert "not smooth" in judged(1e-9 * ATTEMPTS_BETWEEN_CHECKS, 1e-9 * ATTEMPTS_EXAMINED * 2, rough)
    assert "stands still" in judged(0.0, 1.0)
    assert "stands still" in judged(0.0, 1.0, jumped=5)
    assert not judged(0.0, None, jumped=5, last_jump=1000)


def test_runs_that_wait_for_a_jump_end_by_themselves():
    """As `no_more_jumps` (tests/engine/test_statuses.py), long before anything could be said here."""
    assert waiting.MOST_ATTEMPTS_WITHOUT_JUMP <= ATTEMPTS_BETWEEN_CHECKS
    assert not judged(1.0, None, last_jump=100, windows=20)
    assert not judged(1.0, None, jumped=1, last_jump=100, windows=20)


@pytest.mark.slow
def test_a_full_log_of_events_is_no_stall_and_spends_no_attempts():
    """The events of one block fill the log many times; a call that it ends has not made all attempts that it might."""
    jumps = lh.Transition(every=1e-4, reset=lambda t, x, args: -x)
    ticking = lh.Hybrid(lambda t, x, args: jnp.cos(1e3 * t) * jnp.ones_like(x), jumps)
    assert lh.trajectory(ticking, [1.0], t1=2.0, n=1).j[-1] == 20_000
    assert lh.trajectory(ticking, [1.0], t1=0.5, n=1, max_steps=20_000).j[-1] == 5000
