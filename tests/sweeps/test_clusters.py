"""A sweep on a dask cluster: the same dataset, one compilation a worker, and what happens when a worker dies."""

import os
import signal
import time

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import LOGISTIC

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]  # dask and its worker processes warn

RATES = np.linspace(3.0, 4.2, 60)  # beyond 4 the motion escapes


def run(r):
    return lh.lyapunov_spectrum(LOGISTIC, jnp.array([0.3]), r, t1=20_000, blocks=8)


def swept(**keywords):
    return lh.sweep(run, {"args": RATES}, args=3.0, chunk=4, **{"progress": False} | keywords)


@pytest.fixture(scope="module")
def whole():
    return swept()


@pytest.fixture
def client():
    from dask.distributed import Client, LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        yield client


def compiled():
    from lyaphybrid.sweeps import clusters

    return len(clusters._programs)


def test_workers_give_the_same_dataset(client, whole, tmp_path):
    seen = []
    assert swept(client=client, store=tmp_path / "sweep.zarr", progress=seen.append).equals(whole)
    assert seen[-1] == 1.0
    assert sorted(client.run(compiled).values()) == [1, 1]
    assert swept(client=client).equals(whole)
    assert sorted(client.run(compiled).values()) == [1, 1]  # one compilation a worker, of both sweeps
    assert swept(store=tmp_path / "sweep.zarr").equals(whole)


def test_a_worker_that_dies_is_replaced(client, whole, tmp_path):
    victim, first = next(iter(client.run(os.getpid).values())), iter([True])

    def kill(fraction):
        if next(first, False):
            os.kill(victim, signal.SIGKILL)

    assert swept(client=client, store=tmp_path / "sweep.zarr", progress=kill).equals(whole)


def test_what_is_cancelled_leaves_nothing_behind(client, whole, tmp_path):
    def stop(fraction):
        raise KeyboardInterrupt

    with pytest.warns(UserWarning, match="points were not computed"):
        partial = swept(client=client, store=tmp_path / "sweep.zarr", progress=stop)
    known = ~np.isnan(partial.time.values)
    assert 0 < np.sum(known) < len(RATES)
    for _ in range(100):  # what is running comes to its end
        if not any(client.processing().values()):
            break
        time.sleep(0.1)
    assert not any(client.processing().values())
    assert swept(client=client, store=tmp_path / "sweep.zarr").equals(whole)


def test_an_error_of_a_run_is_told(client):
    with pytest.raises(ValueError, match="wants a number"):
        lh.sweep(lambda r: wants(r), {"args": RATES}, args=3.0, client=client, progress=False)


def wants(r):
    raise ValueError("wants a number")
