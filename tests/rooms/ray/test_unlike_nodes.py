"""A node that would compute something else, holds a key or confines too weakly gets no job and is refused by name."""

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import weaker_machine
from interruptions import PATIENCE, ends, finish, results, start, unhurried
from ray_cluster import SETTINGS, RayCluster, ray_cluster
from smallest import UNTRACKED

import tacevo
from tacevo.choices import Confinement
from tacevo.sandbox.confinement import available
from tacevo.sandbox.processes import descendants

pytestmark = [pytest.mark.cluster, unhurried]

#: The baseline alone.
_BRIEF = [UNTRACKED, "search.generations=0", "search.initial=0"]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RayCluster]:
    """Run a head, a node like this machine, and others, each of which differs from it in one thing."""
    with ray_cluster(tmp_path_factory.mktemp("cluster")) as cluster:
        folder = cluster.folder
        _pretend(folder / "torch" / "path", "torch", "9.9.9")
        _change_rules(folder / "rules" / "path")
        support = str(Path(weaker_machine.__file__).parent)
        weaker = f"import sys; sys.path.append({support!r}); from weaker_machine import lose_landlock; lose_landlock()"
        nodes = [
            cluster.add("alike"),
            cluster.add("torch"),
            cluster.add("rules"),
            cluster.add("key", environment={"OPENAI_API_KEY": "sk-on-a-node"}),
            cluster.add("weak", before=weaker),
        ]
        for node in nodes:
            node.wait()
        yield cluster


def _pretend(path: Path, package: str, version: str) -> None:
    """Have a package seem to be installed in another version."""
    metadata = path / f"{package}-{version}.dist-info" / "METADATA"
    metadata.parent.mkdir(parents=True)
    metadata.write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")


def _change_rules(path: Path) -> None:
    """Install a release of this project whose training has another number."""
    root = Path(tacevo.__file__).parent
    shutil.copytree(root, path / "tacevo", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(root.parent / "conf", path / "conf")
    rules = path / "tacevo" / "rules.py"
    text = rules.read_text()
    rules.write_text(re.sub(r"(CURRENT = Rules\(.*training=)\d+", r"\g<1>99", text))
    assert rules.read_text() != text


def search(cluster: RayCluster, folder: Path, *overrides: str) -> "subprocess.CompletedProcess[str]":
    """Run a search on a cluster to its end."""
    where = ["executor=ray", "executor.workers=2", f"executor.address='{cluster.address}'"]
    searching = start(folder, *_BRIEF, *where, *overrides, environment=SETTINGS)
    said, errors = searching.communicate(timeout=PATIENCE)
    return subprocess.CompletedProcess(searching.args, searching.returncode, said, errors)


def refusals(said: str) -> str:
    """Join the lines about refused nodes."""
    return "\n".join(line for line in said.splitlines() if "a node is refused: " in line)


def test_unlike_nodes_get_no_job_and_are_named(cluster: RayCluster, tmp_path: Path) -> None:
    """Each is told with what differs; the others do the work, and the weakest walls among them are named."""
    ended = search(cluster, tmp_path)
    assert ended.returncode == 0, ended.stderr
    told = refusals(ended.stderr)
    assert told.count("\n") == 2
    assert "got torch 9.9.9" in told
    assert re.search(r"got code [0-9a-f]{12}, rules of training 99", told)
    assert "OPENAI_API_KEY" in told
    assert "sk-on-a-node" not in ended.stdout + ended.stderr
    assert "cluster: 2 nodes, 2 slots" in ended.stderr
    if available() is Confinement.kernel:
        assert "confinement: process, the weakest, on node" in ended.stderr
    for name in ("torch", "rules", "key"):
        assert not (cluster.folder / name / "data").exists()  # where images would lie
    held = json.loads((tmp_path / "run" / "run.json").read_text())["confinement"]
    assert all(walls["node"] for walls in held)


@pytest.mark.slow
@pytest.mark.skipif(available() is not Confinement.kernel, reason="no kernel walls here")
def test_demanded_confinement_holds_on_each_node(cluster: RayCluster, tmp_path: Path) -> None:
    """A node without them is refused where the walls of the kernel are demanded, and the other one has them."""
    ended = search(cluster, tmp_path, "sandbox.require=kernel")
    assert ended.returncode == 0, ended.stderr
    assert "sandbox.require" in refusals(ended.stderr)
    held = json.loads((tmp_path / "run" / "run.json").read_text())["confinement"]
    assert [walls["level"] for walls in held] == ["kernel"]


@pytest.mark.slow
def test_cluster_without_one_node_that_will_do_is_an_error(cluster: RayCluster, tmp_path: Path) -> None:
    """The error is that of a node; nothing was run."""
    ended = search(cluster, tmp_path, "gate.memory_mib=100_000_000")
    assert ended.returncode == 2
    assert "error: the nodes of the cluster: expected one with 1 CPU, 100,000,000 MiB" in ended.stderr


#: Asks the head of a Ray for what it stores.
_ASK = "import sys; from ray._raylet import GcsClient; print(GcsClient(sys.argv[1]).internal_kv_keys(b'', b'cluster'))"


def asked(head: str, token: str | None) -> str:
    """Return what a stranger, or one with a token, gets from a head."""
    own = {} if token is None else {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token}
    command = [sys.executable, "-c", _ASK, head]
    rest = {name: value for name, value in os.environ.items() if not name.startswith("RAY_AUTH")}
    done = subprocess.run(command, env={**rest, **own}, capture_output=True, text=True, timeout=PATIENCE, check=False)
    return done.stdout + done.stderr


def test_ray_that_a_search_starts_holds_no_key_and_lets_no_stranger_in(
    whole_search: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On one node, without a cluster: no process below the search has the key, the bytes are equal, and all end.

    Its head answers to a token that the user never set, and to nobody else.
    """
    key = "sk-ant-only-for-the-search"
    own = {"ANTHROPIC_API_KEY": key, "TACEVO_NODE_DATA": str(tmp_path / "data"), "TMPDIR": "/tmp"}
    settings = {name: value for name, value in SETTINGS.items() if not name.startswith("RAY_AUTH")}
    for name in SETTINGS.keys() - settings.keys():
        monkeypatch.delenv(name, raising=False)
    searching = start(tmp_path, UNTRACKED, "executor=ray", environment={**settings, **own})
    seen: set[tuple[str, bool]] = set()
    said: dict[str, str] = {}
    while searching.poll() is None:
        for pid in descendants(searching.pid):
            with contextlib.suppress(OSError):
                command = (Path("/proc") / str(pid) / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                held = (Path("/proc") / str(pid) / "environ").read_bytes()
                seen.add((command, key.encode() in held))
                if "ray::run_job" in command and not said:
                    (head,) = {address for line, _ in seen for address in re.findall(r"--gcs-address=(\S+)", line)}
                    (token,) = re.findall(rb"RAY_AUTH_TOKEN=([0-9a-f]{64})\0", held)
                    said = {"stranger": asked(head, None), "friend": asked(head, token.decode())}
        time.sleep(0.05)
    assert finish(searching) == whole_search[1]
    assert "CLUSTER_METADATA" in said["friend"]
    assert "CLUSTER_METADATA" not in said["stranger"]
    assert "oken" in said["stranger"]
    commands = " ".join(command for command, _ in seen)
    assert "raylet" in commands
    assert "ray::ClusterNode" in commands
    assert "ray::run_job" in commands
    elsewhere = re.compile(r"ray::|site-packages/ray/|tacevo\.sandbox")  # but not our own `git describe`
    assert not [command for command, holds_key in seen if holds_key and elsewhere.search(command)]
    assert results(tmp_path) == results(whole_search[0])
    assert ends(tmp_path)
