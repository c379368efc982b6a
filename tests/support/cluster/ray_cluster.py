"""A real Ray cluster on this machine: each node a session of processes with a directory of its own."""

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from waiting import eventually

#: Seconds after which something is taken for stuck; machines are busy.
PATIENCE = 600

#: In the environment of nodes and searches: a token, and a lost node and a lost head are noticed in seconds.
SETTINGS = {
    "RAY_health_check_initial_delay_ms": "2000",
    "RAY_health_check_period_ms": "1000",
    "RAY_health_check_timeout_ms": "5000",
    "RAY_health_check_failure_threshold": "3",
    "RAY_gcs_rpc_server_reconnect_timeout_s": "30",
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_raylet_start_wait_time_s": "300",
    "RAY_AUTH_MODE": "token",
    "RAY_AUTH_TOKEN": "0123456789abcdef" * 4,
}

_COMMON = [
    "--block",
    "--object-store-memory=80000000",
    "--min-worker-port=0",
    "--max-worker-port=0",
    "--disable-usage-stats",
]

#: The command `ray`.
_RAY = "from ray.scripts.scripts import main; main()"

#: What a node says last when it is there.
_STARTED = "will now block"


@dataclass(frozen=True, eq=False)
class RayNode:
    """A node, which is a session of processes."""

    #: Empty at first; the node keeps its images below, and its processes are known by it.
    folder: Path
    process: subprocess.Popen[bytes]

    def wait(self) -> str:
        """Wait until the node is there; return what it said."""
        log = self.folder / "log"
        eventually(lambda: _STARTED in log.read_text() or self.process.poll() is not None, seconds=PATIENCE)
        assert _STARTED in log.read_text(), log.read_text()
        return log.read_text()

    def kill(self) -> None:
        """Kill all that was started as this node at once, as when its power fails."""
        for pid in [self.process.pid, *self.processes()]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait(PATIENCE)

    def processes(self) -> dict[int, str]:
        """Return the commands of the living processes of this node, by process id."""
        return processes_of(self.folder)

    def jobs(self) -> dict[int, str]:
        """Return those that belong to a run: its process, its tasks, its zygotes and candidates."""
        ours = re.compile(r"ray::(ClusterNode|run_job)|tacevo\.sandbox")
        return {pid: command for pid, command in self.processes().items() if ours.search(command)}


@dataclass(eq=False)
class RayCluster:
    """A head without slots, and nodes."""

    folder: Path
    port: int
    temporary: Path
    #: What `executor.address` is set to.
    address: str = ""
    head: RayNode | None = None
    nodes: list[RayNode] = field(default_factory=list)

    def start_head(self) -> None:
        """Start the head, again perhaps, at the same address."""
        options = f"--head --port={self.port} --num-cpus=0 --include-dashboard=false"
        self.head = self._start("head", options)
        self.address = re.findall(r"--address='([^']+)'", self.head.wait())[0]

    def add(self, name: str, environment: Mapping[str, str] = MappingProxyType({}), before: str = "") -> RayNode:
        """Start a node of one slot; it may not be there yet.

        Args:
            name: of its folder.
            environment: further variables.
            before: code that its first process runs before anything else.
        """
        node = self._start(name, f"--address={self.address} --num-cpus=1", environment, before)
        self.nodes.append(node)
        return node

    def _start(
        self, name: str, options: str, environment: Mapping[str, str] = MappingProxyType({}), before: str = ""
    ) -> RayNode:
        folder = self.folder / name
        (folder / "path").mkdir(parents=True, exist_ok=True)
        own = f"--temp-dir={self.temporary / name}"  # two nodes that start at one moment would share names of sockets
        log = (folder / "log").open("wb")
        process = subprocess.Popen(
            [sys.executable, "-c", f"{before}\n{_RAY}", "start", *options.split(), *_COMMON, own],
            env={
                **os.environ,
                **SETTINGS,
                "TACEVO_NODE_DATA": str(folder / "data"),
                "PYTHONPATH": str(folder / "path"),  # by which the zygotes, whose environment is cleared, are known
                **environment,
            },
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        log.close()
        return RayNode(folder, process)

    def kill(self) -> None:
        """Kill every process of the cluster."""
        for node in [*self.nodes, *([self.head] if self.head else [])]:
            node.kill()
        self.nodes.clear()


@contextlib.contextmanager
def ray_cluster(folder: Path) -> Iterator[RayCluster]:
    """Run a cluster that has a head; add nodes as wanted. In the end no process of it is left."""
    temporary = Path(tempfile.mkdtemp(prefix="ray", dir="/tmp"))  # paths of sockets are short
    cluster = RayCluster(folder, _free_port(), temporary)
    try:
        cluster.start_head()
        yield cluster
    finally:
        cluster.kill()
        assert eventually(lambda: not processes_of(folder), seconds=PATIENCE), processes_of(folder)
        shutil.rmtree(temporary, ignore_errors=True)


def processes_of(folder: Path) -> dict[int, str]:
    """Return the commands of living processes that name a directory in their command line or environment."""
    commands = {}
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (place / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            known = command + (place / "environ").read_bytes().decode(errors="replace")
            if command and f"{folder}/" in known and int(place.name) != os.getpid():
                commands[int(place.name)] = command
    return commands


def _free_port() -> int:
    with socket.socket() as unbound:
        unbound.bind(("127.0.0.1", 0))
        port: int = unbound.getsockname()[1]
        return port
