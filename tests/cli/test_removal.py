"""Promise: `tacevo rm` and `tacevo cache prune` remove what nobody here needs, after a question, and nothing else."""

import contextlib
import io
import json
import shutil
import zipfile
from pathlib import Path

import pytest
from refusals import refused

from tacevo.cli.app import main
from tacevo.config.compose import compose_study
from tacevo.errors import RunError
from tacevo.runs.progress import Progress
from tacevo.storage.files import in_use
from tacevo.storage.removal import removable
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Store
from tacevo.studies.study import study


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
    assert "| probes |" in capsys.readouterr().out


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


def test_rm_removes_a_run_after_a_yes(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What would go is told first; the stores stay."""
    before = entries(folder / "cache")
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    assert main(["rm", "run"]) == 1
    assert "| ledger.jsonl" in capsys.readouterr().out
    assert main(["replay", "run"]) == 0
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert main(["rm", "run"]) == 0
    assert [path.name for path in folder.iterdir()] == ["cache"]
    assert entries(folder / "cache") == before


def test_rm_removes_a_sweep_but_no_job_of_it(sweep: Path) -> None:
    """Whose tables need each job."""
    job = next(sweep.glob("*/run.json")).parent
    with refused(RunError, got="a job of the sweep", remedy="the whole sweep"), removable(job):
        pass
    assert main(["rm", str(sweep), "--yes"]) == 0
    assert not sweep.exists()


def test_rm_leaves_alone_what_is_no_run_or_is_needed(
    folder: Path, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bundle, packed or not, a link, an export, a run that holds stores or another run, and where the user stands."""
    zipfile.ZipFile(bundle).extractall("unpacked")
    Path("link").symlink_to("run")
    Path("network").mkdir()
    shutil.copy("run/run.json", "network")
    shutil.copytree("run", "first")
    shutil.copytree("run", "first/second")
    shutil.copytree("run", "third")
    shutil.copytree("cache", "third/cache")
    reasons = {
        str(bundle): "a file",
        "unpacked": "unpacked",
        "unpacked/run": "unpacked",
        "link": "a link to",
        "network": "without run.json and ledger.jsonl",
        "absent": "without run.json and ledger.jsonl",
        "first": "another run, first/second",
        "third": "the stores third/cache",
    }
    before = sorted(folder.rglob("*"))
    for path, reason in reasons.items():
        with refused(RunError, place=path, got=reason), removable(Path(path)):
            pass
    monkeypatch.chdir("run")
    with refused(RunError, got="this command was started in"), removable(Path("../run")):
        pass
    assert sorted(folder.rglob("*")) == before


def test_rm_leaves_alone_what_is_in_use(folder: Path) -> None:
    """By a search, by what mirrors it, or by a study."""
    run = Path("run")
    with RunDirectory(run).locked(), refused(RunError, got="another process"), removable(run):
        pass
    with in_use(run, alone=True), refused(RunError, got="another process"), removable(run):
        pass

    class Trying(Progress):
        """Tries to remove the run whenever the study says something."""

        refusals = 0

        def say(self, text: str) -> None:
            """Try."""
            with contextlib.suppress(RunError), removable(run):
                return
            self.refusals += 1

    with Trying() as view:
        study(compose_study(["run=run", "elites=1", "seeds=4", "epochs=1"]), view)
    assert view.refusals
    with removable(run):
        pass
