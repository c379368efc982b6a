"""Promise: a run is opened wherever it lies, and what was unpacked for that is gone at the end."""

from pathlib import Path

import pytest

from tacevo.bundle import opened, private_folder, sealed
from tacevo.errors import DivergenceError, RunError


def test_folder_is_opened_where_it_lies(published: Path) -> None:
    """With the stores that its run.json names; nothing is copied."""
    with opened(published / "run") as found:
        assert (found.run, found.store) == (published / "run", published / "cache")
        assert (found.root, found.digest) == (None, None)


def test_bundle_is_opened_under_the_name_of_its_run(published: Path) -> None:
    """A folder of the run's own name, stores beside it, and neither afterwards."""
    with opened(published / "run.zip") as found:
        assert found.run.name == "run"
        assert (found.run / "ledger.jsonl").read_bytes() == (published / "run" / "ledger.jsonl").read_bytes()
        assert any(found.store.glob("completions/*/*.json"))
        assert found.root is not None
        assert (found.root.stat().st_mode & 0o777) == 0o700
    assert not found.root.exists()


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    """Neither a folder of something else nor a name of nothing."""
    for path in (tmp_path, tmp_path / "missing"):
        with pytest.raises(RunError, match=r"is not the folder of a run: it has no run\.json"), opened(path):
            pass


def fail_within(place: Path, error: type[BaseException], made: list[Path]) -> None:
    """Fail over a file in the private folder that stands for a place, and say where that was."""
    with private_folder(place) as folder:
        made.append(folder)
        raise error(f"{folder}/run/a.json differs")


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_private_folder_is_gone_after_an_error(error: type[BaseException], tmp_path: Path) -> None:
    """Whatever ended the work."""
    made: list[Path] = []
    with pytest.raises(error, match="differs"):
        fail_within(tmp_path, error, made)
    assert not made[0].exists()


def test_errors_name_the_place_that_the_folder_stands_for(tmp_path: Path) -> None:
    """A user never sees the temporary folder."""
    made: list[Path] = []
    with pytest.raises(DivergenceError, match=rf"^{tmp_path}/x\.zip/run/a\.json differs$"):
        fail_within(tmp_path / "x.zip", DivergenceError, made)
    assert not made[0].exists()


@pytest.mark.parametrize("name", ["tables/größe.csv", "tables/a b.csv", "notes.txt", "run/candidates/x.py", "../x"])
def test_strange_member_is_not_published(name: str) -> None:
    """What no reader would accept is not written."""
    with pytest.raises(RunError, match="cannot be published"):
        sealed({name: b""})
