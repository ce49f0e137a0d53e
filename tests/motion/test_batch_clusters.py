"""A batch on a Dask and on a Ray cluster, made on this machine, is the one that this process computes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import joblib
import numpy as np
import pytest
from joblib import delayed

import pinposture as pp
from pinposture.motion.processes import adaptively_in_order


@contextmanager
def dask() -> Iterator[None]:
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=2, threads_per_worker=1, dashboard_address=None):
        yield


@contextmanager
def ray() -> Iterator[None]:
    cluster = pytest.importorskip("ray")
    from ray.util.joblib import register_ray

    register_ray()
    cluster.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        yield
    finally:
        cluster.shutdown()


@pytest.mark.process
@pytest.mark.parametrize(("cluster", "count"), [(dask, 60), (ray, 450)])  # more than go to Ray together
def test_a_cluster_computes_the_same_batch_in_order(cluster, count: int) -> None:
    arm = pp.Arm.from_template("RyRz", 3)
    rng = np.random.default_rng(0)
    goals = rng.uniform(-0.5, 0.5, (count, arm.nq))
    targets = [pp.Target.from_configuration(arm, goal) for goal in goals]
    here = pp.track_many(arm, targets, arm.straight(), jobs=1)
    counted: list[tuple[int, int]] = []
    with cluster(), joblib.parallel_config(backend=cluster.__name__):
        found = pp.track_many(arm, targets, arm.straight(), progress=lambda *now: counted.append(now))
        processes = set(adaptively_in_order([delayed(os.getpid)() for _ in range(8)], None))
    assert counted == [(k, count) for k in range(1, count + 1)]
    assert os.getpid() not in processes
    np.testing.assert_array_equal(found.q_final, here.q_final)
    for one, other in zip(found.motions, here.motions, strict=True):
        np.testing.assert_array_equal(one["q"], other["q"])
    np.testing.assert_allclose(found.q_final, goals, atol=1e-4)
