"""Promise: a job ends with the process that launched it, one that fails stops no other, and the next call continues.

Whole sweeps of real searches, as small as they can be; jobs without a search are in test_sweeping.
"""

import fcntl
import json
import os
import pty
import shutil
import signal
import socket
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from checkout import ROOT
from interruptions import comes, ends, leftovers, processes_of, unhurried
from refusals import refused
from smallest import SMALLEST, UNTRACKED
from sweeps import files_of

from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.schema import ExecutorConfig, RunConfig
from tacevo.errors import ConfigError
from tacevo.evolution.run_files import finished_digest
from tacevo.records import to_json
from tacevo.results.sweep import Standing
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord
from tacevo.sweeps import launch as launching
from tacevo.sweeps.launch import SLURM, Launcher, check_launcher, fitted, launch, needed_cores, split_launcher
from tacevo.sweeps.search_process import Starter
from tacevo.sweeps.status import Status, status_of

pytestmark = unhurried

#: Two searches of two candidates each, one after the other.
SWEEP = [
    *SMALLEST,
    UNTRACKED,
    "search.generations=0",
    "search.initial=1",
    "executor.workers=1",
    "store.root=cache",
    "ablation=none,fixed_temperature",
]
ONE_BY_ONE = "hydra.launcher.n_jobs=1"
NONE, FIXED = "none-seed0", "fixed_temperature-seed0"


def start(folder: Path, *overrides: str) -> subprocess.Popen[str]:
    """Start the sweep in a directory, in a session of its own."""
    (folder / "tmp").mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "tacevo.cli.app", "search", "-m", *SWEEP, *overrides, "--into", "all"],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder / "tmp")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def statuses(folder: Path) -> dict[str, Status]:
    """Return how the jobs of the sweep stand, by name."""
    directory = SweepDirectory(folder / "all")
    return {job.name: status_of(directory, job) for job in directory.read().jobs}


def has_begun(folder: Path, name: str) -> bool:
    """Return whether a job has decided something."""
    ledger = folder / "all" / name / "ledger.jsonl"
    return ledger.exists() and ledger.read_bytes().count(b"\n") > 1


def test_launcher_is_separated_from_the_jobs() -> None:
    """Only what names a launcher goes to it."""
    settings = ["seed=0,1", "hydra/launcher=submitit_slurm", "hydra.launcher.partition=gpu", "hydra.launcher.nodes=1"]
    launcher = Launcher(cluster=SLURM, options={"partition": "gpu", "nodes": 1})
    assert split_launcher(settings) == (launcher, ("seed=0,1",))
    assert split_launcher(["seed=0,1"]) == (Launcher(options={}), ("seed=0,1",))


@pytest.mark.parametrize(
    ("overrides", "place", "expected"),
    [
        (["hydra/launcher=rq"], "hydra/launcher", "submitit_slurm"),
        (["hydra/launcher=submitit_slurm"] * 2, "hydra/launcher", "submitit_slurm"),
        (["hydra.launcher.n_jobs=[1", "seed=0"], "hydra.launcher", "NAME=VALUE"),
    ],
)
def test_launcher_that_is_not_known_is_rejected(overrides: list[str], place: str, expected: str) -> None:
    """A sweep has one launcher, or none; the message names its options, and no parser."""
    with refused(ConfigError, place=place, expected=expected):
        split_launcher(overrides)


@pytest.mark.parametrize("name", ["basic", "joblib"])
def test_launchers_of_hydra_for_one_machine_go_on_and_say_what_takes_their_place(name: str) -> None:
    """With the options of ours, of which `n_jobs` is joblib's, too."""
    launcher, rest = split_launcher([f"hydra/launcher={name}", "hydra.launcher.n_jobs=3", "seed=0,1"])
    assert (launcher.cluster, launcher.options, rest) == ("", {"n_jobs": 3}, ("seed=0,1",))
    check_launcher(launcher)
    assert "n_jobs=N" in launcher.remark
    with refused(ConfigError, place="hydra/launcher", got=f"{name} and"):
        split_launcher([f"hydra/launcher={name}", "hydra/launcher=submitit_slurm"])


@pytest.mark.parametrize(
    ("launcher", "place"),
    [
        (Launcher(options={"njobs": 2}), "hydra.launcher"),
        (Launcher(options={"n_jobs": "x"}), "hydra.launcher"),
        (Launcher(options={"n_jobs": 0}), "hydra.launcher"),
        (Launcher(cluster=SLURM, options={"partitions": "gpu"}), "hydra/launcher=submitit_slurm"),
        (Launcher(cluster=SLURM, options={"timeout_min": "x"}), "hydra/launcher=submitit_slurm"),
        (Launcher(cluster=SLURM, options={"max_num_timeout": "x"}), "hydra/launcher=submitit_slurm"),
    ],
)
def test_option_that_a_launcher_does_not_have_is_rejected(launcher: Launcher, place: str) -> None:
    """A misspelt one, or a value of another type."""
    with refused(ConfigError, place=place):
        check_launcher(launcher)


def test_key_among_the_options_is_rejected_and_not_repeated() -> None:
    """Options become the script of a job, which Slurm and the sweep's directory keep."""
    setup = {"setup": ["export ANTHROPIC_API_KEY=sk-secret"]}
    with refused(ConfigError) as caught:
        check_launcher(Launcher(cluster=SLURM, options=setup))
    assert caught.value.got.endswith("ANTHROPIC_API_KEY=...")
    assert caught.value.remedy
    assert "sk-secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("jobs", "workers", "cores", "n_jobs"), [(10, 2, 8, 4), (10, 3, 8, 2), (3, 2, 8, 3), (10, 4, 2, 1), (10, 1, 1, 1)]
)
def test_jobs_times_workers_fit_the_cores(jobs: int, workers: int, cores: int, n_jobs: int) -> None:
    """At most as many jobs as there are, and as cores for their workers, and always one; the user has the last word."""
    assert fitted(Launcher(options={}), jobs=jobs, needed=workers, cores=cores).options == {"n_jobs": n_jobs}
    assert fitted(Launcher(options={"n_jobs": 7}), jobs=jobs, needed=workers, cores=cores).options == {"n_jobs": 7}
    slurm = Launcher(cluster=SLURM, options={"timeout_min": 9})
    told = fitted(slurm, jobs=jobs, needed=workers, cores=cores).options
    assert told == {"cpus_per_task": workers, "timeout_min": 9}


@pytest.mark.parametrize(("address", "n_jobs", "cpus"), [("head:6379", 10, 1), ("auto", 10, 1), (None, 1, 64)])
def test_jobs_that_share_a_ray_cluster_are_not_bounded_by_the_cores_here(
    address: str | None, n_jobs: int, cpus: int
) -> None:
    """Only their searches run here; a Ray that each starts for itself runs here as well."""
    executor = ExecutorConfig(kind="ray", workers=64, address=address)
    needed = needed_cores(replace(compose(SMALLEST), executor=executor))
    assert fitted(Launcher(options={}), jobs=10, needed=needed, cores=4).options == {"n_jobs": n_jobs}
    slurm = Launcher(cluster=SLURM, options={})
    assert fitted(slurm, jobs=10, needed=needed, cores=4).options == {"cpus_per_task": cpus, "timeout_min": 60}


def test_search_of_a_table_takes_one_core() -> None:
    """It trains nothing, whatever the number of workers."""
    config = compose(["experiment=space", "data=table", "data.root=table.zip", "executor.workers=8"])
    assert needed_cores(config) == 1


@pytest.mark.few(2)
@pytest.mark.parametrize("how", ["", "idle", "before its order", "with its order"])
def test_process_that_starts_searches_can_be_killed(how: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One process starts a search after the other; where it is killed, its job has failed, and another goes on."""
    made: list[Starter] = []

    class Told(Starter):
        def __init__(self, directory: SweepDirectory) -> None:
            super().__init__(directory)
            made.append(self)

        def start(self, job: Job, config: RunConfig) -> None:
            if how == "before its order" and job == one:
                kill(self)
            super().start(job, config)
            if how == "with its order" and job == one:
                kill(self)

    def kill(starter: Starter) -> None:
        starter.process.kill()
        starter.process.wait()

    def show(job: Job) -> None:
        if how == "idle" and job == one:
            kill(made[0])

    monkeypatch.setattr(launching, "Starter", Told)
    directory = SweepDirectory(place / "all")
    one, other = (Job(name=name, arm=name, seed=0, overrides=(), config=name) for name in ("one", "other"))
    directory.write(SweepRecord(overrides=tuple(SMALLEST), jobs=(one, other)))
    wrong = replace(compose(SMALLEST), seed=-1)
    launch(directory, {one: wrong, other: wrong}, Launcher(options={"n_jobs": 1}), show)

    assert len(made) == (2 if how else 1)
    assert ("killed by signal 9" if "order" in how else "seed") in str(directory.failure(one))
    assert "seed" in str(directory.failure(other))
    assert ends(directory.path), processes_of(directory.path)


#: Searches that say whether their table had been read, and how much garbage collections leave alone.
TELLING = """
import gc
from tacevo.cli import starter
from tacevo.results import space_table

def tell(config):
    hits = space_table._read.cache_info().hits
    space_table.read_table(space_table.Path(config.data.root))
    print("read" if space_table._read.cache_info().hits > hits else "not read", gc.get_freeze_count() > 0, flush=True)

starter.run_search = tell
starter.serve()
"""


@pytest.mark.room("table")
def test_table_is_read_before_searches_begin(tmp_path: Path) -> None:
    """Once for all; one that cannot be read is each search's to refuse, and its log has the reason."""
    damaged = tmp_path / "damaged.zip"
    damaged.write_bytes(b"no table")
    tables = [ROOT / "cache" / "tables" / "grating-space.zip", damaged]
    ours, theirs = socket.socketpair()
    ours.settimeout(60)
    with ours, theirs, subprocess.Popen([sys.executable, "-P", "-c", TELLING], stdin=theirs.fileno()) as process:
        theirs.close()
        for table, (status, said) in zip(tables, [(0, "read True"), (1, "refused: ")], strict=True):
            config = compose(["experiment=table", f"data.root={table}"])
            log = tmp_path / f"{table.name}.log"
            log.touch()
            ours.sendall(json.dumps({"config": to_json(config), "log": str(log)}).encode() + b"\n")
            assert ours.recv(8) == f"{status}\n".encode(), log.read_text()
            assert log.read_text().startswith(said)
        ours.shutdown(socket.SHUT_WR)
        assert process.wait() == 0


#: A search that writes that it is there, and stays.
STAYING = """
import time
from tacevo.cli import starter

def stay(config):
    print("searching", flush=True)
    time.sleep(600)

starter.run_search = stay
starter.serve()
"""


Staying = tuple[subprocess.Popen[str], Callable[[], None], socket.socket]


@pytest.fixture
def staying(tmp_path: Path) -> Iterator[Staying]:
    """Yield a process that has started a search, what orders another, and the channel that tells how they ended."""
    ours, theirs = socket.socketpair()
    order = json.dumps({"config": to_json(compose(SMALLEST)), "log": str(tmp_path / "log")}).encode() + b"\n"
    ours.settimeout(60)
    (tmp_path / "log").write_bytes(b"")
    with (
        ours,
        theirs,
        subprocess.Popen(
            [sys.executable, "-P", "-c", STAYING, str(tmp_path)], stdin=theirs.fileno(), text=True
        ) as process,
    ):
        theirs.close()
        ours.sendall(order)
        assert comes(process, lambda: "searching" in (tmp_path / "log").read_text())
        yield process, lambda: ours.sendall(order), ours
        process.kill()


def test_search_ends_with_the_process_that_started_it(staying: Staying, tmp_path: Path) -> None:
    """However that was killed."""
    process, _, _ = staying
    assert len(processes_of(tmp_path)) == 2
    process.kill()
    process.wait()
    assert ends(tmp_path), processes_of(tmp_path)


def test_polite_signal_reaches_the_search(staying: Staying) -> None:
    """At work, and where it came before there was one; the process that started it hears the end, and goes on."""
    process, order, channel = staying
    process.terminate()
    assert channel.recv(8) == b"143\n"
    process.send_signal(signal.SIGSTOP)
    order()
    process.terminate()
    process.send_signal(signal.SIGCONT)
    assert channel.recv(8) == b"143\n"
    channel.shutdown(socket.SHUT_WR)
    assert process.wait() == 0


@pytest.mark.slow
def test_view_that_fails_stops_the_other_jobs_and_is_raised(place: Path) -> None:
    """Progress that cannot be shown, on a terminal that is gone, is an error and leaves no process behind."""
    directory = SweepDirectory(place / "all")
    quick, slow = (Job(name=name, arm=name, seed=0, overrides=(), config=name) for name in ("quick", "slow"))
    directory.write(SweepRecord(overrides=tuple(SMALLEST), jobs=(quick, slow)))
    endless = compose([*SMALLEST, "search.generations=999", UNTRACKED])
    configs = {quick: replace(endless, seed=-1), slow: endless}

    def show(job: Job) -> None:
        assert job == quick
        raise OSError("the terminal is gone")

    with pytest.raises(OSError, match="the terminal is gone"):
        launch(directory, configs, Launcher(options={"n_jobs": 2}), show)
    assert ends(directory.path), processes_of(directory.path)
    assert "seed" in str(directory.failure(quick))
    assert directory.failure(slow) is None


@pytest.mark.slow
def test_failed_job_stops_no_other_and_is_repeated(
    published: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The failure is listed with its reason; then it alone runs, and its digest is that of the search by itself."""
    shutil.copytree(published / "cache", place / "cache")  # with all answers
    (place / "all").mkdir()
    (place / "all" / NONE).write_text("in the way")
    assert main(["search", "-m", *SWEEP, "--into", "all", ONE_BY_ONE]) == 1
    assert f"{NONE}: run.dir=all/{NONE}: expected a directory" in capsys.readouterr().out
    assert main(["show", "all"]) == 0
    assert "2 jobs: 1 finished, 1 failed" in capsys.readouterr().out
    assert main(["show", "all", FIXED]) == 2
    assert FIXED in capsys.readouterr().err
    assert main(["show", "all", "g00s00"]) == 2
    assert "all/JOB; got g00s00" in capsys.readouterr().err

    (place / "all" / NONE).unlink()
    before = files_of(place / "all" / FIXED)
    assert main(["search", "-m", *SWEEP, "--into", "all", ONE_BY_ONE]) == 0
    assert "2 jobs: 2 finished" in capsys.readouterr().out
    assert files_of(place / "all" / FIXED) == before
    assert not list((place / "all" / "failed").iterdir())

    alone = [setting for setting in SWEEP if not setting.startswith("ablation=")]
    assert main(["search", *alone, "run.dir=alone"]) == 0
    digest = capsys.readouterr().out.splitlines()[-1].removeprefix("digest: ")
    assert statuses(place)[NONE].digest == digest


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_stopped_sweep_leaves_no_process_and_is_resumed(how: signal.Signals, published: Path, tmp_path: Path) -> None:
    """However the command ends, its job ends with it and keeps what it has; the next call continues to the end."""
    sweep = start(tmp_path, ONE_BY_ONE)
    assert comes(sweep, lambda: has_begun(tmp_path, NONE))
    sweep.send_signal(how)
    _, errors = sweep.communicate()
    assert sweep.returncode == (143 if how is signal.SIGTERM else -how), errors
    assert ends(tmp_path), processes_of(tmp_path)
    stopped = statuses(tmp_path)
    assert stopped[NONE].standing in {Standing.stopped, Standing.finished}
    assert stopped[FIXED].standing is Standing.waiting

    shutil.copytree(published / "cache", tmp_path / "cache", dirs_exist_ok=True)  # with all answers
    again = start(tmp_path, ONE_BY_ONE)
    out, errors = again.communicate()
    assert again.returncode == 0, errors
    assert "2 jobs: 2 finished" in out
    assert ends(tmp_path), processes_of(tmp_path)


@pytest.mark.slow
def test_ctrl_c_at_a_terminal_ends_jobs_as_it_ends_searches(tmp_path: Path) -> None:
    """Each search is interrupted as by its own Ctrl-C, and reports it."""
    terminal, end = pty.openpty()
    settings = [*SWEEP, "search.generations=99", "hydra.launcher.n_jobs=2"]
    sweep = subprocess.Popen(
        [sys.executable, "-P", "-m", "tacevo.cli.app", "search", "-m", *settings, "--into", "all"],
        cwd=tmp_path,
        stdin=end,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=partial(fcntl.ioctl, 0, termios.TIOCSCTTY, 0),  # noqa: PLW1509  # takes no lock, and imports nothing
    )
    assert comes(sweep, lambda: has_begun(tmp_path, NONE) and has_begun(tmp_path, FIXED))
    os.write(terminal, b"\x03")
    _, errors = sweep.communicate()
    os.close(terminal)
    os.close(end)
    assert sweep.returncode == 130, errors
    assert "Traceback" not in errors
    for name in (NONE, FIXED):
        said = (tmp_path / "all" / "launch" / f"{name}.log").read_text()
        assert any(f"interrupted; {kept}" in said for kept in ("what was computed is kept", "nothing is finished yet"))
    assert ends(tmp_path), processes_of(tmp_path)


@pytest.mark.long
def test_sweep_killed_again_and_again_ends_with_the_digests_of_its_searches(tmp_path: Path) -> None:
    """Each kill comes later; finished jobs are not touched by the next call, and no trace of a kill stays."""
    sizes = ["search.generations=2", "search.candidates=4", "seed=0,1", "hydra.launcher.n_jobs=2"]
    finished: dict[str, dict[str, int]] = {}
    for last in (NONE, FIXED, "fixed_temperature-seed1"):
        sweep = start(tmp_path, *sizes)
        struck = comes(sweep, lambda name=last: has_begun(tmp_path, name))  # type: ignore[misc]
        sweep.kill()
        sweep.communicate()
        assert struck
        assert ends(tmp_path), processes_of(tmp_path)
        for name, before in finished.items():
            assert files_of(tmp_path / "all" / name) == before
        ended = [name for name, status in statuses(tmp_path).items() if status.standing is Standing.finished]
        finished = {name: files_of(tmp_path / "all" / name) for name in ended}
    assert finished
    sweep = start(tmp_path, *sizes)
    _, errors = sweep.communicate()
    assert sweep.returncode == 0, errors
    assert ends(tmp_path), processes_of(tmp_path)
    for name, before in finished.items():
        assert files_of(tmp_path / "all" / name) == before
    assert not leftovers(tmp_path)

    alone = [setting for setting in SWEEP if not setting.startswith(("ablation=", "store.root="))]
    for status in statuses(tmp_path).values():
        place = [f"run.dir={tmp_path}/alone/{status.job.name}", f"store.root={tmp_path}/elsewhere"]
        assert main(["search", *alone, *sizes[:2], *status.job.overrides, *place]) == 0
        assert finished_digest(SweepDirectory(tmp_path / "alone").run(status.job)) == status.digest
