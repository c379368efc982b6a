"""MLflow shows of each search which data set it trained on and which code made it, by its own means."""

import json
import subprocess
from pathlib import Path

from mirrored import CODE, DATA, LINES, build_run, facts, mirror_once, open_store

from tacevo.environment import Code, checked_out
from tacevo.errors import RunError
from tacevo.storage.run_directory import RunRecord
from tacevo.tracking.shown import data_set, source_tags
from tacevo.typed import convert


def described(source: str = "simulated", root: str | None = None) -> RunRecord:
    """Return what run.json says of a run's data and code."""
    return convert(RunRecord, facts(source=source, root=root), place="run.json", error=RunError)


def test_search_has_its_data_set_as_an_input_and_names_its_code(tmp_path: Path, uri: str) -> None:
    """MLflow's own store gives the data set back once, with name, digest and context, however often mirrored.

    The source of search and candidates is the command, their version the commit that run.json has, if it has one.
    """
    build_run(tmp_path / "run", LINES)
    mirror_once(tmp_path / "run", uri)
    mirror_once(tmp_path / "run", uri)
    client, search, candidates = open_store(uri)
    inputs = client.get_run(search.info.run_id).inputs
    assert inputs is not None
    (given,) = (each.to_dictionary() for each in inputs.dataset_inputs)
    digest = DATA.fingerprint[:36]
    assert given["tags"] == {"mlflow.data.context": "training"}
    assert (given["dataset"]["name"], given["dataset"]["digest"]) == ("force (simulated)", digest)
    assert len(client.search_runs([search.info.experiment_id], f"dataset.digest = '{digest}'")) == 1
    command = {"mlflow.source.name": "tacevo search", "mlflow.source.type": "LOCAL"}
    version = {"mlflow.source.git.commit": CODE["commit"], "mlflow.source.git.dirty": "false"}
    for run in (search, *candidates.values()):
        shown = {key: value for key, value in run.data.tags.items() if key.startswith("mlflow.source.")}
        assert shown == {**command, **version}
    assert source_tags(None) == command


def test_mlflow_reads_the_source_of_a_data_set() -> None:
    """In the form of its own classes; nothing is shown of a place that the param `data.root` does not show."""
    from mlflow.data import get_source
    from mlflow.entities import Dataset

    for run in (described(), described("folder", "images")):
        assert get_source(Dataset(**data_set(run))).to_json() == data_set(run)["source"]
    for root in ("images", None):
        assert json.loads(data_set(described("csv", root))["source"]) == {"uri": root or ""}


def test_checkout_tells_its_commit_and_whether_it_was_changed(tmp_path: Path) -> None:
    """Files that Git does not know change nothing."""

    def git(*arguments: str) -> str:
        identity = ["-c", "user.name=A. Nyone", "-c", "user.email=a@example.org"]
        return subprocess.run(
            ["git", *identity, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout.strip()

    assert checked_out(tmp_path) is None
    git("init")
    assert checked_out(tmp_path) is None  # nothing was committed
    (tmp_path / "code.py").write_text("pass\n")
    git("add", "code.py")
    git("commit", "--message", "Begin")
    (tmp_path / "notes.txt").write_text("of no consequence")
    commit = git("rev-parse", "HEAD")
    assert checked_out(tmp_path) == Code(commit=commit, dirty=False)
    (tmp_path / "code.py").write_text("1\n")
    assert checked_out(tmp_path) == Code(commit=commit, dirty=True)
    assert checked_out(tmp_path / "below") is None
