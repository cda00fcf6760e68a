"""Several threads at once, forked processes, and processes that are told to end."""

import os
import signal
import subprocess
import sys
import threading
import time

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

LONG = """
import sys
import jax; jax.config.update("jax_enable_x64", True)
import lyaphybrid as lh
from lyaphybrid.engine.host import checkpoints
checkpoints.SECONDS_BETWEEN_WRITES = 0.0
print("begun", flush=True)
problem = lh.zoo.lorenz63()
problem.spectrum(t1=5e3, transient=0.0, blocks=100, checkpoint=sys.argv[1])
print("ended")
"""
FORKED = """
import os, sys, warnings
import jax; jax.config.update("jax_enable_x64", True)
import lyaphybrid as lh
warnings.simplefilter("ignore")  # Python's own, of a fork of a process with threads
if sys.argv[1] == "after":
    lh.zoo.lorenz63().spectrum(t1=1.0)
child = os.fork()
if child == 0:
    try:
        print(lh.zoo.lorenz63().spectrum(t1=1.0).status, flush=True)
    except RuntimeError as error:
        print(error, flush=True)
    os._exit(0)
os.waitpid(child, 0)
"""


def forked(when):
    command = [sys.executable, "-c", FORKED, when]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this platform")
def test_a_fork_before_anything_is_computed_computes():
    assert forked("before").startswith("ok")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this platform")
def test_a_fork_after_it_is_refused_instead_of_waiting_for_ever():
    assert "forked after JAX had begun to compute" in forked("after")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM on Windows")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGKILL"])
def test_a_run_that_is_told_to_end_goes_on_from_its_checkpoint(name, tmp_path):
    """The same bits as of a run that nobody disturbed."""
    kept = tmp_path / "run.npz"
    command = [sys.executable, "-c", LONG, kept]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        until = time.monotonic() + 120
        while not kept.exists() or kept.stat().st_size <= 10_000:
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        process.send_signal(getattr(signal, name))
        assert process.wait(60) == -getattr(signal, name)
    problem, length = lh.zoo.lorenz63(), {"t1": 5e3, "transient": 0.0, "blocks": 100}
    resumed = problem.spectrum(**length, checkpoint=kept, resume=True)
    whole = problem.spectrum(**length)
    assert np.array_equal(resumed.exponents, whole.exponents)
    assert np.array_equal(resumed.history.exponents, whole.history.exponents)


def ball(t, x, r):
    return jnp.stack([x[1], -jnp.ones_like(x[1])])


BALL = lh.Hybrid(ball, lh.Transition(lambda t, x, r: x[0], lambda t, x, r: jnp.stack([x[0], -r * x[1]])))
LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))


def runs(i):
    """Runs of two systems, the same ones in all threads, but with numbers of their own."""
    impacts = lh.trajectory(BALL, [1.0 + i, 0.0], 0.9, t1=4.0, n=8)
    return np.asarray(impacts.x), np.asarray(lh.lyapunov_spectrum(LOGISTIC, [0.3], 3.9 - i / 100, t1=300).exponents)


def test_threads_at_once_find_what_they_find_alone():
    found: dict = {}
    threads = [threading.Thread(target=lambda i=i: found.update({i: runs(i)})) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(4):
        for one, other in zip(found[i], runs(i), strict=True):
            assert np.array_equal(one, other)
