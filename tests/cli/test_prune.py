"""Promise: `tacevo cache prune` removes what no run here needs, after a question, and nothing else."""

import io
import json
import shutil
from pathlib import Path

import pytest

from tacevo.cli.app import main
from tacevo.storage.store import Store


def entries(stores: Path) -> set[Path]:
    """List the entries of stores."""
    return set(stores.glob("*/*/*.json"))


@pytest.fixture
def stray(folder: Path) -> Path:
    """Add an entry that no run asked for to the stores of `folder`."""
    store = Store(folder / "cache", "probes")
    store.write({"of": "nobody"}, {"profile": "none"})
    return store.path(store.key({"of": "nobody"}))


def test_prune_removes_what_no_run_needs(stray: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run and its study replay afterwards, and a second time nothing is left to remove."""
    assert main(["cache", "prune", "--yes"]) == 0
    assert not stray.exists()
    assert main(["replay", "run"]) == 0
    before = entries(folder / "cache")
    assert main(["cache", "prune"]) == 0
    assert "every entry of cache is needed by 1 run" in capsys.readouterr().out
    assert entries(folder / "cache") == before


@pytest.mark.parametrize("said", ["", "no\n", "yes please\n"])
def test_prune_removes_nothing_without_a_yes(
    said: str, stray: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor where nobody can answer; what would go is told."""
    monkeypatch.setattr("sys.stdin", io.StringIO(said))
    assert main(["cache", "prune"]) == 1
    assert stray.exists()
    assert "1 file of 0.0 MB (probes 1)" in capsys.readouterr().out


def test_prune_needs_to_know_what_runs_need(
    stray: Path, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an unfinished study or run needs is not known; of no run, or one with other stores, nothing is removed."""
    before = entries(folder / "cache")
    (path,) = Path("run/studies").glob("*/study.json")
    finished = path.read_text()
    path.write_text(json.dumps({**json.loads(finished), "digest": None}))
    assert main(["cache", "prune", "--yes"]) == 2
    assert "one that is not finished" in capsys.readouterr().err
    path.write_text(finished)

    described = json.loads(Path("run/run.json").read_text())
    Path("run/run.json").write_text(json.dumps({**described, "digest": None}))
    assert main(["cache", "prune", "--yes"]) == 2
    Path("run/run.json").write_text(json.dumps(described))

    (folder / "empty").mkdir()
    assert main(["cache", "prune", "empty", "--yes"]) == 2
    assert "expected a run of these stores; got none" in capsys.readouterr().err

    shutil.copytree("cache", "other")
    assert main(["cache", "prune", "--store", "other", "--yes"]) == 2
    assert "run has other stores, cache, and is passed over" in capsys.readouterr().err
    assert entries(folder / "cache") == before

    Path("behind").mkdir()
    shutil.move("run", "behind/run")
    Path("linked").symlink_to("behind")
    assert main(["cache", "prune", "linked", "--yes"]) == 0
    assert entries(folder / "cache") == before - {stray}


def test_prune_keeps_what_a_run_of_another_directory_needs(stray: Path, folder: Path) -> None:
    """Its relative store is the one beside it, also where the working directory has another of that name."""
    before = entries(folder / "cache")
    project = folder / "project"
    project.mkdir()
    for name in ("run", "cache"):
        shutil.move(name, project / name)
    Store(folder / "cache", "probes").write({"of": "another project"}, {"profile": "none"})
    assert main(["cache", "prune", "project", "--store", "project/cache", "--yes"]) == 0
    kept = {path.relative_to(folder) for path in before - {stray}}
    assert {path.relative_to(project) for path in entries(project / "cache")} == kept
    assert len(entries(folder / "cache")) == 1
