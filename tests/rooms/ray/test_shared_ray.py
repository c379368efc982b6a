"""Promise: the searches of a sweep, and a study, share one Ray cluster, and have the digests of this machine."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cluster_sweeps import FIXED, NONE, STUDY, SWEEP, TACEVO, TWO, digest, has_begun, study_digest
from interruptions import PATIENCE, comes, unhurried
from ray_cluster import SETTINGS, RayCluster, ray_cluster
from waiting import eventually

pytestmark = [pytest.mark.cluster, unhurried]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RayCluster]:
    """Run a head and two nodes with one slot each."""
    with ray_cluster(tmp_path_factory.mktemp("shared")) as cluster:
        for node in [cluster.add(name) for name in ("a", "b")]:
            node.wait()
        yield cluster


def on(cluster: RayCluster, folder: Path, *command: str, core: int | None = None) -> subprocess.Popen[str]:
    """Start a command with its candidates on the cluster; on one processor, perhaps."""
    return subprocess.Popen(
        [*([] if core is None else ["taskset", "--cpu-list", str(core)]), *TACEVO, *command, *address(cluster)],
        cwd=folder,
        env={**os.environ, **SETTINGS},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def address(cluster: RayCluster) -> list[str]:
    """Return the settings that name the cluster."""
    return ["executor=ray", f"executor.address='{cluster.address}'"]


@pytest.mark.slow
def test_two_searches_of_a_sweep_share_a_cluster(cluster: RayCluster, tmp_path: Path, alone: Path) -> None:
    """Both run at once, though the command has one processor and each search wants two: the cluster has the slots."""
    core = min(os.sched_getaffinity(0))
    sweep = on(cluster, tmp_path, "search", "-m", *SWEEP, TWO, "--into", "all", core=core)
    both = (NONE, FIXED)
    assert comes(sweep, lambda: all(has_begun(tmp_path, name) for name in both))
    assert not any(digest(tmp_path, name) for name in both)
    out, errors = sweep.communicate(timeout=PATIENCE)
    assert sweep.returncode == 0, out + errors
    assert [digest(tmp_path, name) for name in both] == [digest(alone, name) for name in both]
    assert eventually(lambda: not any(node.jobs() for node in cluster.nodes), seconds=PATIENCE)


def test_study_on_a_cluster_has_the_digest_of_this_machine(
    cluster: RayCluster, tmp_path: Path, alone: Path, studied_alone: Path
) -> None:
    """Its trainings run on both nodes."""
    shutil.copytree(alone, tmp_path, dirs_exist_ok=True)
    study = on(cluster, tmp_path, "study", f"run=all/{NONE}", *STUDY, "executor.workers=2")
    out, errors = study.communicate(timeout=PATIENCE)
    assert study.returncode == 0, out + errors
    assert study_digest(tmp_path) == study_digest(studied_alone)
