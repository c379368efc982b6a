"""What a person finds in MLflow: who and what a search was, what to read of it, and what to do where MLflow fails."""

import getpass
import os
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mirrored import LINES, build_run, contents, mirror_once, open_store

from tacevo.records import to_json
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.track import track
from tacevo.tracking.tracker import Mirror


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """Return a finished run, with a page."""
    build_run(tmp_path / "run", LINES)
    (tmp_path / "run" / "report.html").write_text("<p>a page</p>")
    return tmp_path / "run"


def artifacts(uri: str, folder: Path) -> dict[str, str]:
    """Read what the search's run holds to read."""
    client, search, _ = open_store(uri)
    names = [file.path for file in client.list_artifacts(search.info.run_id)]
    return {name: Path(client.download_artifacts(search.info.run_id, name, str(folder))).read_text() for name in names}


def test_search_says_who_and_what_it_was(run_dir: Path, uri: str) -> None:
    """User, description, model and task stand where MLflow shows and filters them; candidates have the user, too.

    What is changed there, such as a description, stays.
    """
    mirror_once(run_dir, uri)
    client, search, candidates = open_store(uri)
    tags = search.data.tags
    assert tags["mlflow.user"] == getpass.getuser()
    assert (tags["mlflow.note.content"], tags["tacevo.model"], tags["tacevo.task"]) == ("found", "m", "force")
    assert {run.data.tags["mlflow.user"] for run in candidates.values()} == {getpass.getuser()}
    experiment = client.get_experiment(search.info.experiment_id)
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"
    chosen = {"mlflow.user": "ada", "mlflow.note.content": "mine"}
    for tag, value in chosen.items():
        client.set_tag(search.info.run_id, tag, value)
    mirror_once(run_dir, uri)
    assert chosen.items() <= open_store(uri)[1].data.tags.items()


def test_search_of_an_unknown_user_names_none(run_dir: Path, uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container may run under a number that nothing names."""

    def unknown() -> str:
        raise KeyError("getpwuid(): uid not found: 4711")

    monkeypatch.setattr(getpass, "getuser", unknown)
    mirror_once(run_dir, uri)
    assert "tacevo.digest" in open_store(uri)[1].data.tags


def test_summary_and_page_are_there_and_a_page_that_was_written_again_replaces_it(
    run_dir: Path, uri: str, tmp_path: Path
) -> None:
    """As after a study, which the first one does not show; one that is older than the end of the run is not taken.

    However often it is mirrored, nothing is there twice, and nothing is written into the run directory.
    """
    os.utime(run_dir / "report.html", (0, 0))
    mirror_once(run_dir, uri)
    assert artifacts(uri, tmp_path) == {"summary.md": "found"}
    for words in ("<p>a page</p>", "<p>with a study</p>"):
        (run_dir / "report.html").write_text(words)
        before = {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}
        mirror_once(run_dir, uri)
        first = contents(uri)
        mirror_once(run_dir, uri)
        assert contents(uri) == first
        assert artifacts(uri, tmp_path) == {"summary.md": "found", "report.html": words}
        assert {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()} == before


def test_labelled_model_is_nowhere_called_by_its_path(run_dir: Path, uri: str) -> None:
    """The label is the model's name in params and tags; the path stands in run.json alone."""
    recorded = RunDirectory(run_dir).read_run()
    llm = {"provider": "openai", "model": "/srv/models/secret", "label": "mine"}
    RunDirectory(run_dir).write_json("run.json", to_json(replace(recorded, config={**recorded.config, "llm": llm})))
    mirror_once(run_dir, uri)
    search = open_store(uri)[1]
    assert (search.data.params["llm.model"], search.data.tags["tacevo.model"]) == ("mine", "mine")
    assert "/srv/models" not in str(contents(uri))


def test_deleted_experiment_is_told_once_with_what_restores_it(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """Its number stands in the command; restored, it takes the run."""
    build_run(tmp_path / "another", LINES[:2])
    mirror_once(run_dir, uri)
    client, search, _ = open_store(uri)
    client.delete_experiment(search.info.experiment_id)
    _, (failed,) = track(tmp_path, uri, lambda done, total: None)
    assert "MLflow experiment tacevo" in failed
    assert f"mlflow experiments restore --experiment-id {search.info.experiment_id}`" in failed
    client.restore_experiment(search.info.experiment_id)
    assert track(tmp_path, uri, lambda done, total: None) == ({uri: 2}, ())


@pytest.fixture
def silent() -> Iterator[str]:
    """Return the address of a server that takes connections and never answers."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.slow
def test_store_that_does_not_answer_is_not_said_to_be_written(run_dir: Path, silent: str) -> None:
    """One line says that the mirror is still at it: no other command may write there meanwhile."""
    mirror = Mirror([run_dir], uri=silent, experiment="tacevo")
    try:
        warning = str(mirror.finish(5))
    finally:
        process: Any = mirror._process
        process.kill()
        process.wait()
    assert "still writes" in warning
    assert "\n" not in warning
