"""A real Slurm on this machine: a controller and two node daemons in a directory of their own, gone at the end.

Each node claims the processors of this machine for itself, so two nodes run as many jobs as two machines would.
"""

import contextlib
import getpass
import os
import random
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from waiting import eventually

from tacevo.sandbox.kernel import end_with

#: What Debian's package slurm-wlm brings.
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "scancel", "scontrol")

#: A requeued job waits for `cred_expire` s, a job asked to end has `KillWait` s, a silent node is down after 10 s.
_CONFIGURATION = """\
ClusterName=tests
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket,cred_expire=5
CredType=cred/munge
SlurmUser={user}
SlurmdUser={user}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
KillWait=30
SlurmctldTimeout=10
SlurmdTimeout=10
SchedulerParameters=batch_sched_delay=1,sched_interval=1
SlurmdParameters=config_overrides
{nodes}
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE
"""

#: Seconds for daemons and jobs to change their state; the machine may be busy.
PATIENCE = 300


class Slurm:
    """The cluster, as long as its context lasts."""

    def __init__(self, folder: Path, nodes: Sequence[str]) -> None:
        self.folder, self.nodes = folder, tuple(nodes)
        self._daemons: dict[str, subprocess.Popen[bytes]] = {}
        self._configuration = folder / "slurm.conf"
        #: What a process needs in its environment to submit to this cluster.
        self.environment = {"SLURM_CONF": str(self._configuration)}

    def run(self, *command: str, **environment: str) -> str:
        """Run one of Slurm's commands, with further variables in its environment; return what it prints."""
        every = {**os.environ, **self.environment, **environment}
        return subprocess.run(command, env=every, capture_output=True, text=True, check=True).stdout.strip()

    def jobs(self) -> dict[str, str]:
        """Return the state of each job that Slurm remembers, by its id; each of an array's by its own."""
        listed = self.run("squeue", "--noheader", "--array", "--states=all", "--format=%i %T").splitlines()
        return dict(line.split() for line in listed)

    def running(self) -> list[str]:
        """Return the ids of the jobs that run."""
        return [job for job, state in self.jobs().items() if state == "RUNNING"]

    def node_of(self, job: str) -> str:
        """Return the node on which a job runs."""
        return self.run("squeue", "--noheader", f"--jobs={job}", "--format=%N")

    def is_idle(self) -> bool:
        """Return whether nothing is queued or running."""
        return not self.run("squeue", "--noheader")

    def kill_node(self, node: str) -> None:
        """End all processes of a node at once, as a power failure does."""
        self._daemons[node].kill()
        self._daemons.pop(node).wait()
        for pid in _processes_of(node, self._configuration):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def start_node(self, node: str) -> None:
        """Start the daemon of a node, and wait until it takes jobs."""
        # Processes of a node are known by this variable, which Slurm gives to those of jobs.
        self._start(node, ["slurmd", "-D", "-N", node, "-f", str(self._configuration)], SLURMD_NODENAME=node)
        self._await(lambda: self.run("sinfo", "--noheader", f"--nodes={node}", "--format=%t") in {"idle", "mix"})

    def _begin(self) -> None:
        """Start all daemons, and wait until each answers."""
        folder = self.folder
        for name in ("munge", "state", *self.nodes):
            (folder / name).mkdir(mode=0o755)
        key = folder / "munge" / "key"
        key.touch(mode=0o600)
        key.write_bytes(secrets.token_bytes(128))
        ports = _free_ports(1 + len(self.nodes))
        cores, host = len(os.sched_getaffinity(0)), socket.gethostname()
        nodes = "\n".join(
            f"NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={cores}"
            for node, port in zip(self.nodes, ports[1:], strict=True)
        )
        self._configuration.write_text(
            _CONFIGURATION.format(host=host, controller=ports[0], folder=folder, user=getpass.getuser(), nodes=nodes)
        )
        munge = [f"--{name}-file={folder}/munge/{name}" for name in ("key", "log", "pid", "seed")]
        self._start("munged", ["munged", "--foreground", f"--socket={folder}/munge/socket", *munge])
        self._await((folder / "munge" / "socket").exists)
        self._start("slurmctld", ["slurmctld", "-D", "-f", str(self._configuration)])
        self._await(lambda: "UP" in self.run("scontrol", "ping"))
        for node in self.nodes:
            self.start_node(node)

    def _end(self) -> None:
        """End all jobs and daemons."""
        for node in self.nodes:
            if node in self._daemons:
                self.kill_node(node)
        for daemon in reversed(self._daemons.values()):
            daemon.kill()
            daemon.wait()

    def _start(self, name: str, command: Sequence[str], **environment: str) -> None:
        with (self.folder / f"{name}.log").open("ab") as log:
            self._daemons[name] = subprocess.Popen(
                command,
                env={**os.environ, **self.environment, **environment},
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a terminal's Ctrl-C is the tests'
                preexec_fn=partial(end_with, os.getpid()),  # noqa: PLW1509  # takes no lock, and imports nothing
            )

    def _await(self, answers: Callable[[], bool]) -> None:
        def alive_and_answers() -> bool:
            ended = [name for name, daemon in self._daemons.items() if daemon.poll() is not None]
            assert not ended, "\n".join((self.folder / f"{name}.log").read_text() for name in ended)
            try:
                return answers()
            except subprocess.CalledProcessError:
                return False

        assert eventually(alive_and_answers, seconds=PATIENCE), f"Slurm does not come up; see {self.folder}"


@contextlib.contextmanager
def slurm_cluster(nodes: Sequence[str] = ("n1", "n2")) -> Iterator[Slurm]:
    """Run a Slurm; on leaving, nothing of it runs, nor of its jobs."""
    folder = Path(tempfile.mkdtemp(prefix="slurm"))  # munged refuses a directory that others cannot enter, as pytest's
    folder.chmod(0o755)
    cluster = Slurm(folder, nodes)
    try:
        cluster._begin()
        yield cluster
    finally:
        cluster._end()
        shutil.rmtree(folder)


def missing_programs() -> list[str]:
    """List what is not installed here."""
    return [program for program in PROGRAMS if shutil.which(program) is None]


def _free_ports(count: int) -> list[int]:
    """Find ports below those that the kernel gives to connections, which may take one before a daemon does."""
    ports: set[int] = set()
    while len(ports) < count:
        port = random.randrange(11000, 19000)
        with socket.socket() as unbound, contextlib.suppress(OSError):
            unbound.bind(("127.0.0.1", port))
            ports.add(port)
    return list(ports)


def _processes_of(node: str, configuration: Path) -> list[int]:
    """List the processes of a node's jobs, by their environment."""
    marks = {f"SLURMD_NODENAME={node}".encode(), f"SLURM_CONF={configuration}".encode()}
    numbers = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if marks <= set((process / "environ").read_bytes().split(b"\0")):
                numbers.append(int(process.name))
    return numbers
