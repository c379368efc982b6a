"""Promise: a job ends with whoever launched it, one that is killed or fails stops no other, and the next call goes on.

Whole sweeps of real searches, as small as they can be; jobs without a search are in test_sweeping.
"""

import fcntl
import os
import pty
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from interruptions import comes, leftovers, processes_of, unhurried, wait_until
from smallest import SMALLEST, UNTRACKED
from sweeps import files_of

from tacevo.cli.app import main
from tacevo.errors import ConfigError, RunError
from tacevo.search.files import finished_digest
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.sweeps.launch import Assignment, Launcher, fitted, launch, split_launcher, watch
from tacevo.sweeps.status import Standing, Status, status_of

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
    """Start the sweep in a folder, in a session of its own."""
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
    """Tell how the jobs of the sweep stand, by name."""
    directory = SweepDirectory(folder / "all")
    return {job.name: status_of(directory, job) for job in directory.read()[1]}


def has_begun(folder: Path, name: str) -> bool:
    """Tell whether a job has decided something."""
    ledger = folder / "all" / name / "ledger.jsonl"
    return ledger.exists() and ledger.read_bytes().count(b"\n") > 1


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give an empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def assigned(folder: Path) -> Iterator[Assignment]:
    """Give the assignment of a job whose search would run."""
    directory = SweepDirectory(folder / "all")
    directory.launch.mkdir(parents=True)
    directory.write(SMALLEST, [Job(name=NONE, arm="none", seed=0, overrides=("seed=0",), config="a" * 64)])
    yield Assignment(sweep=str(directory.path), job=NONE, caller=os.getpid(), since=start_of(os.getpid()))
    assert not directory.failure(directory.read()[1][0])


def test_launcher_is_parted_from_the_jobs() -> None:
    """Only what names a launcher goes to it; one is all that a sweep has."""
    settings = ["seed=0,1", "hydra/launcher=submitit_slurm", "hydra.launcher.partition=gpu"]
    launcher = Launcher(name="submitit_slurm", overrides=("hydra.launcher.partition=gpu",))
    assert split_launcher(settings) == (launcher, ("seed=0,1",))
    assert split_launcher(["seed=0,1"]) == (Launcher(name="joblib", overrides=()), ("seed=0,1",))
    with pytest.raises(ConfigError, match="one launcher; got joblib and basic"):
        split_launcher(["hydra/launcher=joblib", "hydra/launcher=basic"])


@pytest.mark.parametrize(
    ("jobs", "workers", "cores", "n_jobs"), [(10, 2, 8, 4), (10, 3, 8, 2), (3, 2, 8, 3), (10, 4, 2, 1), (10, 1, 1, 1)]
)
def test_jobs_times_workers_fit_the_cores(jobs: int, workers: int, cores: int, n_jobs: int) -> None:
    """No more jobs than there are, no more workers than cores, and always one job."""
    chosen = fitted(Launcher(name="joblib", overrides=()), jobs=jobs, workers=workers, cores=cores)
    assert chosen.overrides == (f"hydra.launcher.n_jobs={n_jobs}",)


@pytest.mark.parametrize(
    ("name", "own", "expected"),
    [
        ("joblib", ("hydra.launcher.n_jobs=7",), ("hydra.launcher.n_jobs=7",)),
        ("submitit_slurm", (), ("hydra.launcher.cpus_per_task=2",)),
        ("submitit_slurm", ("hydra.launcher.cpus_per_task=9",), ("hydra.launcher.cpus_per_task=9",)),
        ("submitit_local", (), ()),
    ],
)
def test_user_has_the_last_word_on_the_launcher(name: str, own: tuple[str, ...], expected: tuple[str, ...]) -> None:
    """What was set is left, and a launcher is told nothing that it does not take."""
    assert fitted(Launcher(name=name, overrides=own), jobs=4, workers=2, cores=8).overrides == expected


def test_halted_sweep_begins_no_job(assigned: Assignment) -> None:
    """Jobs that still wait when a sweep is stopped come to nothing, and are no failures."""
    directory = SweepDirectory(Path(assigned.sweep))
    directory.halt.touch()
    watch(assigned)
    assert not directory.log(NONE).exists()


def status_of_watch(assignment: Assignment) -> int:
    """Run a watchman as a process; give its exit status."""
    pid = os.fork()
    if pid == 0:
        watch(assignment)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


@pytest.mark.parametrize("reaped", [True, False])
def test_job_begins_nothing_without_its_caller(assigned: Assignment, reaped: bool) -> None:
    """A process whose launcher has died ends instead of waiting for more jobs, also before the launcher is reaped."""
    ended = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    since = start_of(ended.pid)
    ended.stdin.close()  # type: ignore[union-attr]
    os.waitid(os.P_PID, ended.pid, os.WEXITED | (0 if reaped else os.WNOWAIT))
    assert status_of_watch(Assignment(sweep=assigned.sweep, job=NONE, caller=ended.pid, since=since)) == 130
    assert not SweepDirectory(Path(assigned.sweep)).log(NONE).exists()
    ended.poll()


def test_another_process_with_the_callers_number_is_not_the_caller(assigned: Assignment) -> None:
    """Numbers of processes are given again; one that started at another time is another."""
    assert status_of_watch(Assignment(sweep=assigned.sweep, job=NONE, caller=os.getpid(), since=1)) == 130
    assert not SweepDirectory(Path(assigned.sweep)).log(NONE).exists()


def start_of(pid: int) -> int:
    """Read the 22nd field of what the system says of a process: when it started."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])


def test_onlooker_that_fails_stops_the_jobs_and_is_heard(assigned: Assignment) -> None:
    """Progress that cannot be shown, on a terminal that is gone, is an error and leaves no process behind."""
    directory = SweepDirectory(Path(assigned.sweep))

    def look() -> None:
        raise OSError("the terminal is gone")

    with pytest.raises(OSError, match="the terminal is gone"):
        launch(directory, directory.read()[1], Launcher(name="basic", overrides=()), look)
    assert wait_until(lambda: not processes_of(directory.path)), processes_of(directory.path)
    assert status_of(directory, directory.read()[1][0]).standing is not Standing.finished


def test_launcher_that_fails_is_told_with_its_reason(assigned: Assignment) -> None:
    """What it said last is the message."""
    directory = SweepDirectory(Path(assigned.sweep))
    with pytest.raises(RunError, match=r"hydra/launcher=nowhere failed: .*Could not find 'hydra/launcher/nowhere'"):
        launch(directory, directory.read()[1], Launcher(name="nowhere", overrides=()), lambda: None)


def test_failed_job_stops_no_other_and_is_repeated(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The failure is listed with its reason; then it alone runs, and its digest is that of the search by itself."""
    (folder / "all").mkdir()
    (folder / "all" / NONE).write_text("in the way")
    assert main(["search", "-m", *SWEEP, "--into", "all", ONE_BY_ONE]) == 1
    assert f"{NONE}: run.dir=all/{NONE} cannot be used" in capsys.readouterr().out
    assert main(["sweep", "status", "all"]) == 0
    assert "2 jobs: 1 finished, 1 failed" in capsys.readouterr().out

    (folder / "all" / NONE).unlink()
    before = files_of(folder / "all" / FIXED)
    assert main(["search", "-m", *SWEEP, "--into", "all", ONE_BY_ONE]) == 0
    assert "2 jobs: 2 finished" in capsys.readouterr().out
    assert files_of(folder / "all" / FIXED) == before
    assert not list((folder / "all" / "failed").iterdir())

    alone = [setting for setting in SWEEP if not setting.startswith("ablation=")]
    assert main(["search", *alone, "run.dir=alone", "store.root=elsewhere"]) == 0
    digest = capsys.readouterr().out.splitlines()[-1].removeprefix("digest: ")
    assert statuses(folder)[NONE].digest == digest


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_stopped_sweep_leaves_no_process_and_is_taken_up(how: signal.Signals, tmp_path: Path) -> None:
    """However the command ends, its job ends with it and keeps what it has; the next call goes on to the end."""
    sweep = start(tmp_path, ONE_BY_ONE)
    assert comes(sweep, lambda: has_begun(tmp_path, NONE))
    sweep.send_signal(how)
    _, errors = sweep.communicate()
    assert sweep.returncode == (130 if how is signal.SIGINT else -how), errors
    assert wait_until(lambda: not processes_of(tmp_path)), processes_of(tmp_path)
    stopped = statuses(tmp_path)
    assert stopped[NONE].standing in {Standing.stopped, Standing.finished}
    assert stopped[FIXED].standing is Standing.waiting

    again = start(tmp_path, ONE_BY_ONE)
    out, errors = again.communicate()
    assert again.returncode == 0, errors
    assert "2 jobs: 2 finished" in out
    assert wait_until(lambda: not processes_of(tmp_path)), processes_of(tmp_path)


def test_ctrl_c_at_a_terminal_ends_jobs_as_it_ends_searches(tmp_path: Path) -> None:
    """Each search says that it was interrupted, which it cannot where a launcher's processes end before."""
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
        assert "interrupted; what was computed is kept" in SweepDirectory(tmp_path / "all").log(name).read_text()
    assert wait_until(lambda: not processes_of(tmp_path)), processes_of(tmp_path)


@pytest.mark.slow
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
        assert wait_until(lambda: not processes_of(tmp_path)), processes_of(tmp_path)
        for name, before in finished.items():
            assert files_of(tmp_path / "all" / name) == before
        ended = [name for name, status in statuses(tmp_path).items() if status.standing is Standing.finished]
        finished = {name: files_of(tmp_path / "all" / name) for name in ended}
    assert finished
    sweep = start(tmp_path, *sizes)
    _, errors = sweep.communicate()
    assert sweep.returncode == 0, errors
    assert wait_until(lambda: not processes_of(tmp_path)), processes_of(tmp_path)
    for name, before in finished.items():
        assert files_of(tmp_path / "all" / name) == before
    assert not leftovers(tmp_path)

    alone = [setting for setting in SWEEP if not setting.startswith(("ablation=", "store.root="))]
    for status in statuses(tmp_path).values():
        place = [f"run.dir={tmp_path}/alone/{status.job.name}", f"store.root={tmp_path}/elsewhere"]
        assert main(["search", *alone, *sizes[:2], *status.job.overrides, *place]) == 0
        assert finished_digest(SweepDirectory(tmp_path / "alone").run(status.job)) == status.digest


@pytest.mark.slow
def test_submitit_runs_a_sweep_and_stops_it(tmp_path: Path) -> None:
    """With the executor for one machine: on Ctrl-C all jobs end, and the next call ends the sweep."""
    pytest.importorskip("submitit")
    sweep = start(tmp_path, "hydra/launcher=submitit_local")
    assert comes(sweep, lambda: has_begun(tmp_path, NONE))
    sweep.send_signal(signal.SIGINT)
    sweep.communicate()
    assert sweep.returncode == 130
    assert wait_until(lambda: not processes_of(tmp_path)), processes_of(tmp_path)
    again = start(tmp_path, "hydra/launcher=submitit_local")
    out, errors = again.communicate()
    assert again.returncode == 0, errors
    assert "2 jobs: 2 finished" in out
