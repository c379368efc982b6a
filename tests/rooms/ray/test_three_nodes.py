"""A search on the nodes of a Ray cluster ends in the bytes of one on this machine, whatever is killed meanwhile."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from interruptions import PATIENCE, ends, finish, results, start, unhurried
from ray_cluster import SETTINGS, RayCluster, RayNode, ray_cluster
from smallest import UNTRACKED
from waiting import eventually

pytestmark = [pytest.mark.cluster, unhurried]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RayCluster]:
    """Run a head and three nodes with one slot each."""
    with ray_cluster(tmp_path_factory.mktemp("cluster")) as cluster:
        for node in [cluster.add(name) for name in ("a", "b", "c")]:
            node.wait()
        yield cluster


def search(cluster: RayCluster, folder: Path) -> "subprocess.Popen[str]":
    """Start a search on a cluster, or continue the one that was begun in a directory."""
    where = ["executor=ray", "executor.workers=3", f"executor.address='{cluster.address}'"]
    return start(folder, UNTRACKED, *where, environment={**SETTINGS, "ANTHROPIC_API_KEY": "sk-ant-not-for-nodes"})


def running(cluster: RayCluster, what: str = "ray::run_job") -> list[tuple[RayNode, int]]:
    """List the processes of a name, by default the tasks that hold a slot and wait, with their nodes."""
    return [(node, pid) for node in cluster.nodes for pid, command in node.jobs().items() if what in command]


def is_quiet(cluster: RayCluster) -> bool:
    """Tell whether no process of a run is left on any node."""
    return not any(node.jobs() for node in [*cluster.nodes, cluster.head] if node)


def confinement(folder: Path) -> list[dict[str, str]]:
    """Read what run.json says of the nodes."""
    walls: list[dict[str, str]] = json.loads((folder / "run" / "run.json").read_text())["confinement"]
    return walls


def test_three_nodes_give_the_bytes_of_this_machine(
    cluster: RayCluster, whole_search: tuple[Path, str], tmp_path: Path
) -> None:
    """Ledger, archives, candidates and stores are those of this machine; each node has the images, and no label."""
    assert all(not (node.folder / "data").exists() for node in cluster.nodes)
    assert finish(search(cluster, tmp_path)) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])
    held = confinement(tmp_path)
    assert 1 <= len({walls["node"] for walls in held}) == len(held) <= 3
    assert all(walls["level"] for walls in held)
    for node in cluster.nodes:
        files = [path.name for path in (node.folder / "data").rglob("*") if path.is_file() and path.suffix]
        assert sorted(set(files) - {name for name in files if name.endswith("lock")}) == ["images.npy"]
    assert eventually(lambda: is_quiet(cluster), seconds=PATIENCE)


@pytest.mark.few(1)
@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill -9"])
def test_search_that_ends_in_the_middle_is_continued(
    cluster: RayCluster, signal_: signal.Signals, whole_search: tuple[Path, str], tmp_path: Path
) -> None:
    """No process of it stays on any node, and the same command ends in the same bytes."""
    stopped = search(cluster, tmp_path)
    assert eventually(lambda: bool(running(cluster)), seconds=PATIENCE)
    os.kill(stopped.pid, signal_)
    _, errors = stopped.communicate(timeout=PATIENCE)
    assert stopped.returncode == (130 if signal_ is signal.SIGINT else -signal.SIGKILL), errors
    assert eventually(lambda: is_quiet(cluster), seconds=PATIENCE), [node.jobs() for node in cluster.nodes]
    assert ends(tmp_path)
    assert finish(search(cluster, tmp_path)) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])


def test_node_that_is_killed_in_the_middle_changes_nothing(
    cluster: RayCluster, whole_search: tuple[Path, str], tmp_path: Path
) -> None:
    """Its jobs run again on others, and no candidate is rejected for it."""
    searching = search(cluster, tmp_path)
    assert eventually(lambda: bool(running(cluster)), seconds=PATIENCE)
    node, _ = running(cluster)[0]
    node.kill()
    cluster.nodes.remove(node)
    assert finish(searching) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])
    cluster.add("d").wait()


@pytest.mark.slow
def test_processes_of_ray_that_are_killed_are_no_verdict(
    cluster: RayCluster, whole_search: tuple[Path, str], tmp_path: Path
) -> None:
    """A task and a node's process that the kernel kills for want of memory, say, are started again."""
    searching = search(cluster, tmp_path)
    for victim in ("ray::run_job", "ray::ClusterNode"):
        assert eventually(lambda: bool(running(cluster)), seconds=PATIENCE)
        os.kill(running(cluster, victim)[0][1], signal.SIGKILL)
    assert finish(searching) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])


@pytest.mark.slow
def test_head_and_last_node_that_go_and_come_back_lose_nothing(
    cluster: RayCluster, whole_search: tuple[Path, str], tmp_path: Path
) -> None:
    """A search ends with an error that names a lost head; with a new one the same command continues.

    It waits for a node where the last one is lost, and the new one does the rest.
    """
    stopped = search(cluster, tmp_path)
    assert eventually(lambda: bool(running(cluster)), seconds=PATIENCE)
    assert cluster.head is not None
    cluster.head.kill()
    _, errors = stopped.communicate(timeout=PATIENCE)
    assert stopped.returncode == 2, errors
    assert cluster.address in errors
    assert ends(tmp_path)
    assert eventually(lambda: is_quiet(cluster), seconds=PATIENCE), [node.jobs() for node in cluster.nodes]
    cluster.kill()
    cluster.start_head()
    last = cluster.add("e")
    last.wait()
    continued = search(cluster, tmp_path)
    assert eventually(lambda: bool(running(cluster)), seconds=PATIENCE)
    last.kill()
    cluster.nodes.remove(last)
    cluster.add("f").wait()
    assert finish(continued) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])
