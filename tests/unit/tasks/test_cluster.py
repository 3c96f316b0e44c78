"""Work in pieces is the same wherever it is done: in this process, in two, on a cluster that loses a worker."""

import os
import signal
from collections.abc import Iterator
from dataclasses import fields
from functools import partial
from typing import Any

import joblib
import numpy as np
import pytest
from support.campaigns import draw

from armflex import Arm, load_arm, map_workspace, read_measurements
from armflex.bench.fit_bayesian import evident_prior, sample
from armflex.bench.network_problem import scaled_problem
from armflex.estimate import bootstrap
from armflex.parallel import in_order
from armflex.tasks.workspace import WorkspaceMap

pytestmark = pytest.mark.slow

ROWS = 80
"""Of a map, in pieces of four: more than two workers finish before one of them is killed."""


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two worker processes of one thread each, as on two machines; dead ones are started again."""
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    with (
        distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as workers,
        distributed.Client(workers) as client,
    ):
        yield client


def mapped(arm: Arm, **options: object) -> WorkspaceMap:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("armflex.tasks.workspace.workspace_map.CHUNK", 4)
        return map_workspace(arm, ["none", "p600"], rows=ROWS, seed=4, voxel=2.0, **options)


def same(one: WorkspaceMap, other: WorkspaceMap) -> bool:
    """Return whether two maps agree to the last bit."""
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(WorkspaceMap))
    return all(np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray) else a == b for a, b in pairs)


@pytest.fixture(scope="module")
def serial(tarm: Arm) -> WorkspaceMap:
    return mapped(tarm)


def test_two_processes_give_the_same_map(tarm, serial):
    assert same(mapped(tarm, jobs=2), serial)


def test_a_cluster_gives_the_same_map(cluster, tarm, serial):
    with joblib.parallel_config(backend="dask"):
        assert same(mapped(tarm), serial)


def test_a_killed_worker_loses_nothing(cluster, tarm, serial):
    """Killed, not asked to leave: what it was doing is done again elsewhere."""
    before = set(cluster.run(os.getpid).values())
    victim = min(before)
    seen = []

    def kill_at_third(done: int, total: int) -> None:
        seen.append(done)
        if len(seen) == 3:
            os.kill(victim, signal.SIGKILL)

    with joblib.parallel_config(backend="dask"):
        found = mapped(tarm, progress=kill_at_third)
    assert same(found, serial)
    assert seen == sorted(seen) and ROWS in seen
    cluster.wait_for_workers(2)
    assert victim not in cluster.run(os.getpid).values()


def bench(rows: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) loads and noisy deflections that are quadratic in them."""
    rng = np.random.default_rng(8)
    loads = rng.uniform(-1e3, 1e3, (rows, 3))
    clean = loads @ np.diag([1e-6, 2e-6, 3e-6]) + 1e-10 * loads**2
    return loads, clean + 1e-5 * rng.standard_normal((rows, 3))


def chains_of_a_network() -> np.ndarray:
    problem, _ = scaled_problem(*bench(), neurons=3)
    return sample(problem, "metropolis", seed=1, chains=2, draws=60, prior=evident_prior(problem, 1)).weights


def test_a_cluster_gives_the_same_chains(cluster):
    here = chains_of_a_network()
    with joblib.parallel_config(backend="dask"):
        assert np.array_equal(chains_of_a_network(), here)
    assert here.shape[0] == 2 and not np.array_equal(here[0], here[1])


def test_a_cluster_gives_the_same_fits(cluster, tmp_path):
    drawn = draw("none", 5, "six").write(tmp_path)
    arm = load_arm(drawn.arm)
    rows = read_measurements(drawn.train, arm)
    here = bootstrap(arm, rows, draws=2, seed=2)
    with joblib.parallel_config(backend="dask"):
        np.testing.assert_allclose(bootstrap(arm, rows, draws=2, seed=2).values, here.values, rtol=1e-9, atol=1e-14)


def where(number: int) -> int:
    return os.getpid()


def nested() -> list[int]:
    return list(in_order(partial(where, number) for number in range(3)))


def test_pieces_of_a_piece_stay_where_it_is(cluster):
    with joblib.parallel_config(backend="dask"):
        done = list(in_order(nested for _ in range(6)))
    assert all(len(set(places)) == 1 for places in done)
    assert {places[0] for places in done} <= set(cluster.run(os.getpid).values())
