"""What a person finds in MLflow: who and what a search was, what to read of it, and what to do where MLflow fails."""

import getpass
import os
import re
import shlex
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mirrored import LINES, build_run, contents, mirror_once, open_store
from refusals import refused

from tacevo.errors import RunError
from tacevo.records import to_json
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.backfill import track
from tacevo.tracking.entries import note
from tacevo.tracking.process import Mirror


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """Return a finished run."""
    build_run(tmp_path / "run", LINES)
    return tmp_path / "run"


def mirror_with_page(run_dir: Path, uri: str, made: list[Path]) -> None:
    """Mirror a run, with a page that is made quickly, and noted."""
    from tacevo.tracking.mirror import mirror

    def make(run: Path, target: Path) -> None:
        made.append(run)
        target.write_text("<p>made</p>")

    mirror(run_dir, uri=uri, experiment="tacevo", finished=None, reached=None, make_page=make)


def artifacts(uri: str, folder: Path) -> dict[str, str]:
    """Read what the search's run holds to read."""
    client, search, _ = open_store(uri)
    names = [file.path for file in client.list_artifacts(search.info.run_id)]
    return {name: Path(client.download_artifacts(search.info.run_id, name, str(folder))).read_text() for name in names}


def test_search_says_who_and_what_it_was(run_dir: Path, uri: str) -> None:
    """User, description, model and task stand where MLflow shows and filters them; candidates have the user, too."""
    mirror_once(run_dir, uri)
    client, search, candidates = open_store(uri)
    tags = search.data.tags
    assert tags["mlflow.user"] == getpass.getuser()
    assert (tags["mlflow.note.content"], tags["tacevo.model"], tags["tacevo.task"]) == ("found", "m", "force")
    assert {run.data.tags["mlflow.user"] for run in candidates.values()} == {getpass.getuser()}
    experiment = client.get_experiment(search.info.experiment_id)
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"


def test_search_of_an_unknown_user_names_none(run_dir: Path, uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container may run under a number that nothing names."""

    def unknown() -> str:
        raise KeyError("getpwuid(): uid not found: 4711")

    monkeypatch.setattr(getpass, "getuser", unknown)
    mirror_once(run_dir, uri)
    assert "tacevo.digest" in open_store(uri)[1].data.tags


def test_what_the_user_chose_in_mlflow_stays(run_dir: Path, uri: str) -> None:
    """Who wrote the run first, a description that was edited, and the kind of the experiment."""
    mirror_once(run_dir, uri)
    client, search, _ = open_store(uri)
    chosen = {"mlflow.user": "ada", "mlflow.note.content": "mine"}
    for tag, value in chosen.items():
        client.set_tag(search.info.run_id, tag, value)
    client.set_experiment_tag(search.info.experiment_id, "mlflow.experimentKind", "regression")
    mirror_once(run_dir, uri)
    client, search, _ = open_store(uri)
    assert chosen.items() <= search.data.tags.items()
    assert client.get_experiment(search.info.experiment_id).tags["mlflow.experimentKind"] == "regression"


def test_search_has_its_summary_and_its_page(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """Both once, however often it is mirrored; nothing is written into the run directory."""
    made: list[Path] = []
    before = {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}
    mirror_with_page(run_dir, uri, made)
    first = contents(uri)
    mirror_with_page(run_dir, uri, made)
    assert (artifacts(uri, tmp_path), made) == ({"summary.md": "found", "report.html": "<p>made</p>"}, [run_dir])
    assert contents(uri) == first
    assert {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()} == before


def test_page_of_the_user_is_taken_unless_it_is_older_than_the_end(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """One that was written before the run was continued does not show it."""
    made: list[Path] = []
    (run_dir / "report.html").write_text("<p>mine</p>")
    mirror_with_page(run_dir, uri, made)
    assert (artifacts(uri, tmp_path)["report.html"], made) == ("<p>mine</p>", [])
    other = tmp_path / "other"
    build_run(other, LINES)
    (other / "report.html").write_text("<p>old</p>")
    os.utime(other / "report.html", (0, 0))
    mirror_with_page(other, f"sqlite:///{tmp_path}/other.db", made)
    assert artifacts(f"sqlite:///{tmp_path}/other.db", tmp_path)["report.html"] == "<p>made</p>"


def test_page_that_was_written_again_replaces_the_one_in_mlflow(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """As after a study, which the first one does not show; the same page is not written again."""
    mirror_with_page(run_dir, uri, [])
    (run_dir / "report.html").write_text("<p>with a study</p>")
    made: list[Path] = []
    mirror_with_page(run_dir, uri, made)
    assert (artifacts(uri, tmp_path)["report.html"], made) == ("<p>with a study</p>", [])


def test_labelled_model_is_nowhere_called_by_its_path(run_dir: Path, uri: str) -> None:
    """The label is the model's name in params and tags; the path stands in run.json alone."""
    recorded = RunDirectory(run_dir).read_run()
    llm = {"provider": "openai", "model": "/srv/models/secret", "label": "mine"}
    RunDirectory(run_dir).write_json("run.json", to_json(replace(recorded, config={**recorded.config, "llm": llm})))
    mirror_once(run_dir, uri)
    search = open_store(uri)[1]
    assert (search.data.params["llm.model"], search.data.tags["tacevo.model"]) == ("mine", "mine")
    assert "/srv/models" not in str(contents(uri))


def test_search_whose_page_cannot_be_made_has_its_summary(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """The mirror does not fail for it."""
    from tacevo.tracking.mirror import mirror

    mirror(run_dir, uri=uri, experiment="tacevo", finished=None, reached=None, make_page=lambda run, target: None)
    assert artifacts(uri, tmp_path) == {"summary.md": "found"}


def test_long_summary_is_cut_at_a_line() -> None:
    """Older servers refuse a longer tag; its end says where all of it is."""
    summary = "".join(f"| row {number} |\n" for number in range(1_000))
    cut = note(summary)
    assert len(cut) <= 5_000
    assert summary.startswith(cut.partition("\n\n…")[0])
    assert cut.endswith("summary.md, among the artifacts)")


@pytest.mark.parametrize("named", [True, False], ids=["address", "environment"])
def test_deleted_experiment_is_restored_by_the_command_that_is_named(
    named: bool, run_dir: Path, uri: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It restores the very experiment, and then the run is written; an address of the environment is not shown."""
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    mirror_once(run_dir, uri)
    client, search, _ = open_store(uri)
    client.delete_experiment(search.info.experiment_id)
    if not named:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    with refused(RunError, place="MLflow experiment tacevo", got="deleted", remedy="restore") as raised:
        track(run_dir, uri if named else "", lambda done, total: None)
    (command,) = re.findall("`(.*mlflow .*?)` restores", raised.value.remedy)
    assert (f"MLFLOW_TRACKING_URI={uri}" in shlex.split(command)) == named
    assert shlex.split(command)[-4:] == ["experiments", "restore", "--experiment-id", search.info.experiment_id]
    client.restore_experiment(search.info.experiment_id)
    assert track(run_dir, uri, lambda done, total: None).done == {uri: 1}


def test_deleted_experiment_of_many_runs_is_one_line(tmp_path: Path, uri: str) -> None:
    """It is the same of all."""
    for name in ("a", "b"):
        build_run(tmp_path / "runs" / name, LINES[:2])
    mirror_once(tmp_path / "runs" / "a", uri)
    client, search, _ = open_store(uri)
    client.delete_experiment(search.info.experiment_id)
    (failed,) = track(tmp_path / "runs", uri, lambda done, total: None).failed
    assert "mlflow experiments restore" in failed


@pytest.fixture
def silent() -> Iterator[str]:
    """Return the address of a server that takes connections and never answers."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


def test_store_that_does_not_answer_is_not_said_to_be_written(run_dir: Path, silent: str) -> None:
    """One line: the run is not hurt, and which command writes it later."""
    mirror = Mirror(run_dir, uri=silent, experiment="tacevo")
    mirror.start()
    try:
        warning = str(mirror.finish(5))
    finally:
        process: Any = mirror._process
        process.kill()
        process.wait()
    assert "still writing" not in warning
    assert "has not answered" in warning
    assert "\n" not in warning
    assert f"`tacevo track {run_dir}`" in warning


@pytest.mark.slow
def test_real_search_has_its_real_page(published: Path, uri: str, tmp_path: Path) -> None:
    """The page that `tacevo report` writes, made in a process of its own."""
    from tacevo.tracking.page import make_page

    track(published / "run", uri, lambda done, total: None, make_page)
    found = artifacts(uri, tmp_path)
    assert found["summary.md"] == (published / "run" / "summary.md").read_text()
    assert found["report.html"].startswith("<!")
