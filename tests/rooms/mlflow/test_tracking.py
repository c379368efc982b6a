"""The mirror shows a run's ledger in MLflow, writes nothing twice, and never harms the search.

The mirror works in this process where a test is about what it writes, and as a process of its own where the test
is about the process. MLflow is imported only when a test runs, because its telemetry stays off then.
"""

import io
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mirrored import (
    BASELINE,
    GENERATION,
    HEADER,
    LINES,
    MUTATION,
    build_run,
    contents,
    mirror_once,
    open_store,
)
from refusals import refused
from rich.console import Console
from waiting import eventually

from tacevo.config.compose import compose
from tacevo.config.schema import TrackingConfig
from tacevo.costs import Spending
from tacevo.errors import RunError
from tacevo.evolution.run_files import Line
from tacevo.runs.progress import Progress
from tacevo.runs.session import mirrored, mirrored_together
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.tracker import Mirror

#: Seconds after which a process is taken for stuck; the mirror has a low priority, and machines are busy.
PATIENCE = 300


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """Return a finished run."""
    build_run(tmp_path / "run", LINES)
    return tmp_path / "run"


@pytest.mark.slow
def test_mirror_leaves_no_file_open_and_its_failure_is_told(run_dir: Path) -> None:
    """Many searches of one process do not run out of descriptors; and where there are none, the search goes on."""
    before = os.listdir("/proc/self/fd")
    mirror = Mirror([run_dir], uri=f"sqlite:///{run_dir}/run.json/no.db", experiment="tacevo")
    assert mirror.finish(PATIENCE) is not None
    assert os.listdir("/proc/self/fd") == before
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        mirror = Mirror([run_dir], uri="", experiment="tacevo")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert "Too many open files" in str(mirror.finish(None))


def test_search_is_one_run_with_one_nested_run_a_candidate(tmp_path: Path, uri: str) -> None:
    """The parent carries settings, generations and digest, its children the candidates: trained ones with losses.

    The best stands beside the baseline and the trivial loss, so that MLflow draws all three into one chart. Costs of
    timings.jsonl are on each candidate, and their sum on the search. Sources lie beside the database.
    """
    digest = build_run(tmp_path / "run", LINES)
    directory = RunDirectory(tmp_path / "run")
    directory.write_run(replace(directory.read_run(), trivial=0.3))
    for name, dollars in (("g00s01", 0.25), ("g00s02", 0.5)):
        directory.add_timing(Spending(answers=1, input_tokens=10, usd=dollars), id=name)
    mirror_once(tmp_path / "run", uri)
    said = contents(uri)
    assert set(said) == {"parent", "g00s00", "g00s01", "g00s02"}
    name, status, params, tags, histories, _ = said["parent"]
    assert (name, status, params["llm.model"], tags["tacevo.digest"]) == ("run", "FINISHED", "m", digest)
    assert {
        "temperature": [(0, 0.6), (1, 0.65)],
        "generation_best": [(0, 0.25)],
        "candidates": [(0, 3.0), (1, 0.0)],
        "baseline": [(0, 0.25), (1, 0.25)],
        "trivial": [(0, 0.3), (1, 0.3)],
        "usd": [(0, 0.75)],
        "total_input_tokens": [(0, 20.0), (1, 20.0)],
    }.items() <= histories.items()
    name, status, _, _, histories, files = said["g00s00"]
    assert (name, status, files) == ("g00s00", "FINISHED", ["g00s00.py"])
    assert {
        "train_loss": [(1, 0.75), (2, 0.5)],
        "fitness": [(0, 0.25)],
        "niche": [(0, 4.0)],
    }.items() <= histories.items()
    assert "usd" not in histories
    assert said["g00s01"][4]["usd"] == [(0, 0.25)]
    _, status, params, _, histories, files = said["g00s02"]
    assert (status, params["reason"], "fitness" in histories, files) == ("FAILED", "forbidden_import", False, [])
    texts = [file.read_text(encoding="utf-8") for file in (tmp_path / "mlartifacts").rglob("*.py")]
    assert sorted(texts) == ["# g00s00\n", "# g00s01\n"]


@pytest.mark.few(2)
@pytest.mark.parametrize("length", range(1, len(LINES)))
def test_interrupted_search_is_completed(
    length: int, run_dir: Path, uri: str, tmp_path: Path, empty_store: Path
) -> None:
    """Mirrored after any line, and again at the end, a search reads as if it had been mirrored once.

    A finished one that is continued, and killed, loses the digest that it had.
    """
    mirror_once(run_dir, uri)
    other = f"sqlite:///{shutil.copy(empty_store, tmp_path / 'other.db')}"
    interrupted = tmp_path / "interrupted" / run_dir.name
    if length > 1:
        build_run(interrupted, LINES[: length - 1])
        mirror_once(interrupted, other)
    build_run(interrupted, LINES[:length], whole=False)
    mirror_once(interrupted, other)
    _, status, _, tags, _, _ = contents(other)["parent"]
    assert (status, "tacevo.digest" in tags) == ("KILLED", False)
    build_run(interrupted, LINES)
    mirror_once(interrupted, other)
    assert contents(other) == contents(uri)


def test_candidate_left_unfinished_is_replaced(run_dir: Path, uri: str) -> None:
    """A mirror that was killed within a candidate leaves a running run; the next mirror writes it anew."""
    mirror_once(run_dir, uri)
    whole = contents(uri)
    client, _, nested = open_store(uri)
    client.update_run(nested["g00s00"].info.run_id, status="RUNNING")
    mirror_once(run_dir, uri)
    assert contents(uri) == whole
    assert open_store(uri)[2]["g00s00"].info.run_id != nested["g00s00"].info.run_id


OTHERS: dict[str, Sequence[Line]] = {
    "candidate": [HEADER, BASELINE, replace(MUTATION, fitness=0.125), *LINES[3:]],
    "first candidate": [HEADER, replace(BASELINE, fitness=0.125), GENERATION],
}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS.keys())
def test_two_ledgers_are_never_mixed(other: Sequence[Line], run_dir: Path, uri: str) -> None:
    """A search of the same settings and name with other results is an error that names what to delete."""
    mirror_once(run_dir, uri)
    first = contents(uri)
    for path in (run_dir / "ledger.jsonl", run_dir / "run.json"):
        path.unlink()
    build_run(run_dir, other)
    with refused(RunError, place="MLflow run", got="another search", remedy="delete that run in MLflow"):
        mirror_once(run_dir, uri)
    assert {name: values for name, values in contents(uri).items() if name != "parent"} == {
        name: values for name, values in first.items() if name != "parent"
    }


def test_equal_searches_under_two_names_are_two_runs(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """A search is identified by its ledger's header and the name of its directory."""
    mirror_once(run_dir, uri)
    client, parent, _ = open_store(uri)
    build_run(tmp_path / "another", LINES)
    mirror_once(tmp_path / "another", uri)
    searches = client.search_runs([parent.info.experiment_id], "tags.`tacevo.digest` LIKE '%'")
    assert len({run.data.tags["tacevo.run"] for run in searches}) == 2
    assert len({run.data.tags["tacevo.digest"] for run in searches}) == 1


def test_line_without_its_end_waits(run_dir: Path, tmp_path: Path) -> None:
    """A line is read only when it is whole, and then once."""
    from tacevo.tracking.mirror import follow

    whole = (run_dir / "ledger.jsonl").read_text(encoding="utf-8")
    path = tmp_path / "ledger.jsonl"
    path.write_text(whole[: len(whole) // 2], encoding="utf-8")
    answers = iter([False, True])

    def finished() -> bool:
        last = next(answers)
        if last:
            path.write_text(whole, encoding="utf-8")
        return last

    assert [line for _, line in follow(path, finished)] == LINES


@pytest.mark.parametrize(("written", "edited"), [('"slot":1', '"slot":"1"'), ('"niche":4', '"nest":4')])
def test_damaged_line_is_an_error(written: str, edited: str, run_dir: Path, uri: str) -> None:
    """A value of another type, or an unknown field, is not shown as what it nearly is."""
    ledger = run_dir / "ledger.jsonl"
    text = ledger.read_text(encoding="utf-8")
    assert written in text
    ledger.write_text(text.replace(written, edited), encoding="utf-8")
    with refused(RunError, place=str(ledger)):
        mirror_once(run_dir, uri)


def test_search_that_ended_before_its_first_line_is_no_run(tmp_path: Path, uri: str) -> None:
    """Nothing is written of a run without a ledger."""
    from mlflow import MlflowClient

    (tmp_path / "run").mkdir()
    mirror_once(tmp_path / "run", uri)
    assert MlflowClient(uri).get_experiment_by_name("tacevo") is None


@pytest.mark.slow
def test_process_follows_a_growing_ledger(tmp_path: Path, uri: str) -> None:
    """The process writes lines as they come, and ends when it is told that no more will."""
    run_dir = tmp_path / "run"
    build_run(run_dir, LINES[:2], whole=False)
    mirror = Mirror([run_dir], uri=uri, experiment="tacevo")
    assert eventually(lambda: any((tmp_path / "mlartifacts").rglob("g00s00.py")), seconds=PATIENCE)
    digest = build_run(run_dir, LINES)
    assert mirror.finish(PATIENCE) is None
    said = contents(uri)
    assert set(said) == {"parent", "g00s00", "g00s01", "g00s02"}
    assert said["parent"][3]["tacevo.digest"] == digest
    assert (run_dir / "tracking.log").read_text(encoding="utf-8") == ""


def test_address_in_the_environment_is_not_recorded(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole address, with a password, may come from MLFLOW_TRACKING_URI; log and warning name the variable."""
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "nonsense://user:s3cret@nowhere")
    mirror = Mirror([run_dir], uri="", experiment="tacevo")
    warning = mirror.finish(PATIENCE)
    assert "the MLflow mirror to $MLFLOW_TRACKING_URI failed: " in str(warning)
    assert "the run itself is not affected" in str(warning)
    assert "\n" not in str(warning)
    assert "Traceback" in (run_dir / "tracking.log").read_text(encoding="utf-8")
    assert not [path for path in run_dir.rglob("*") if path.is_file() and b"s3cret" in path.read_bytes()]
    assert "s3cret" not in str(warning)


@pytest.mark.slow
def test_database_is_whole_although_the_mirror_that_made_it_was_killed(run_dir: Path, tmp_path: Path) -> None:
    """A mirror killed among MLflow's migrations leaves a hidden file, which the next one replaces."""
    folders = [tmp_path / f"try{number}" for number in range(5)]
    folder = next((folder for folder in folders if left_half_made(run_dir, folder)), None)
    assert folder is not None, "no mirror could be killed while it made its database"
    assert [path.name for path in folder.iterdir() if path.suffix == ".db"] == []
    subprocess.run(mirroring(run_dir, folder), check=True, timeout=PATIENCE)
    assert contents(f"sqlite:///{folder}/mlflow.db")["parent"][1] == "FINISHED"
    assert not list(folder.glob(".*"))


def mirroring(run_dir: Path, folder: Path) -> list[str]:
    """Return the command of a mirror whose database stands in a directory."""
    command = [sys.executable, "-m", "tacevo.tracking", str(run_dir), "--experiment", "tacevo"]
    return [*command, "--uri", f"sqlite:///{folder}/mlflow.db"]


def left_half_made(run_dir: Path, folder: Path) -> bool:
    """Kill a mirror once its database has some tables; False where it was done with the making before it stood still.

    It is stopped first: what is seen of it then is still so when it is killed.
    """
    part = folder / ".mlflow.db.part"
    with subprocess.Popen(mirroring(run_dir, folder)) as mirror:
        assert eventually(lambda: size_of(part) > 60_000 or mirror.poll() is not None, seconds=PATIENCE)
        mirror.send_signal(signal.SIGSTOP)
        if mirror.returncode is None:
            os.waitid(os.P_PID, mirror.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
        half_made = size_of(part) > 60_000
        mirror.kill()
    return half_made


def size_of(path: Path) -> int:
    """Return the size of a file in bytes; 0 of a missing one."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


@pytest.mark.slow
def test_mirror_that_cannot_work_is_one_line_for_the_user(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of its log the last line, or that it is gone; nothing is raised."""
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    for folder, uri, words in (
        (run_dir.parent / "missing", "sqlite:///mlflow.db", "No such file or directory"),
        (run_dir, "", "tracking.uri: expected the address of an MLflow store"),
    ):
        mirror = Mirror([folder], uri=uri, experiment="tacevo")
        assert words in str(mirror.finish(PATIENCE))
    mirror = Mirror([run_dir], uri="", experiment="tacevo")
    (run_dir / "tracking.log").unlink()
    assert "tracking.log" in str(mirror.finish(PATIENCE)).partition(";")[0]


@pytest.mark.slow
def test_slow_mirror_is_left_to_itself(run_dir: Path, uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that needs longer than the search waits is reported, and goes on; where no address is given, in that here."""
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    mirror = Mirror([run_dir], uri="", experiment="tacevo")
    said = str(mirror.finish(0))
    assert "continues by itself" in said
    assert not re.search("tacevo track|tracking.log", said)  # the one would be refused now, the other is empty
    assert mirror.finish(PATIENCE) is None
    assert contents(uri)["parent"][1] == "FINISHED"


def test_experiment_that_another_mirror_creates_at_the_same_time_is_taken() -> None:
    """Two searches begin at once: one creates it, the other finds it, and an error of another kind is not hidden."""
    from mlflow.exceptions import MlflowException

    from tacevo.tracking.store import find_or_create_experiment

    def client(*experiments: SimpleNamespace | None) -> Any:
        answers = iter(experiments)

        def create(*_: object, **__: object) -> str:
            raise MlflowException("it exists, or the database is full")

        return SimpleNamespace(
            get_experiment_by_name=lambda _: next(answers), create_experiment=create, tracking_uri="http://localhost"
        )

    assert find_or_create_experiment(client(None, SimpleNamespace(experiment_id=7)), "tacevo") == "7"
    with pytest.raises(MlflowException, match="the database is full"):
        find_or_create_experiment(client(None, None), "tacevo")


def test_database_that_another_mirror_has_made_meanwhile_is_kept(tmp_path: Path) -> None:
    """What a killed mirror left beside it is removed."""
    from tacevo.tracking.store import _create

    (tmp_path / "mlflow.db").write_bytes(b"made")
    part = tmp_path / ".mlflow.db.part"
    part.touch()
    _create(tmp_path / "mlflow.db")
    assert (tmp_path / "mlflow.db").read_bytes() == b"made"
    assert not part.exists()


@pytest.mark.slow
def test_runs_of_a_sweep_are_mirrored_together_and_waited_for_once(tmp_path: Path, uri: str) -> None:
    """One process writes all of them, one after the other; one that is damaged keeps no other out, and is told."""
    told = io.StringIO()
    view = Progress(Console(file=told, width=300))
    tracking = TrackingConfig(kind="mlflow", uri=uri, experiment="tacevo")
    config = replace(compose(["experiment=demo", "llm=grammar"]), tracking=tracking)
    with mirrored_together(view) as later:
        for name in ("one", "two", "three"):
            build_run(tmp_path / name, LINES)
            later.append((config, RunDirectory(tmp_path / name)))
        (tmp_path / "two" / "ledger.jsonl").write_text("damaged\n")
    said = told.getvalue()
    assert said.count("waiting") == 1
    assert "the runs themselves are not affected" in said or "continues by itself" in said
    assert eventually(lambda: {"one", "three"} <= _finished(uri), seconds=PATIENCE)
    assert "two" not in _finished(uri)
    assert not (tmp_path / "three" / "tracking.log").exists()  # they have one process, hence one log


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # a mirror outlives who started it
@pytest.mark.parametrize("change", [{}, {"uri": "sqlite:///mine.db"}, {"experiment": "mine"}])
def test_only_a_mirror_that_was_asked_for_is_waited_for(
    change: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run whose user said nothing of tracking ends at once, and the mirror is written all the same."""
    monkeypatch.chdir(tmp_path)
    told = io.StringIO()
    tracking = replace(TrackingConfig(), **change)
    config = replace(compose(["experiment=demo", "llm=grammar"]), tracking=tracking)
    assert compose(["experiment=demo"]).tracking == TrackingConfig()
    build_run(tmp_path / "one", LINES)
    with mirrored(config, RunDirectory(tmp_path / "one"), Progress(Console(file=told, width=300))):
        pass
    assert ("waiting" in told.getvalue()) == bool(change)


def _finished(uri: str) -> set[str]:
    """Return the names of the finished runs in a store."""
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    known = client.get_experiment_by_name("tacevo")
    runs = [] if known is None else client.search_runs([known.experiment_id])
    return {str(run.info.run_name) for run in runs if run.info.status == "FINISHED"}
