"""Promise: a page follows a search as far as its whole generations go, and is finished with it."""

import contextlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from refusals import refused

from analysis.report.following import Followed, follow
from analysis.runs.archive_history import load_begun
from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.results.run import read_run
from tacevo.storage.run_directory import RunDirectory


@pytest.fixture
def begun(published: Path, tmp_path: Path) -> Path:
    """Return a copy of a run, cut off after its first generation, as a killed search leaves it."""
    run = Path(shutil.copytree(published / "run", tmp_path / "run"))
    shutil.rmtree(run / "studies")
    described = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**described, "digest": None}))
    lines = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    end = next(number for number, line in enumerate(lines, start=1) if '"kind":"generation"' in line)
    (run / "ledger.jsonl").write_text(
        "".join(lines[: end + 1]) + lines[end + 1][:20]
    )  # a line of the next, and a torn one
    return run


def edit(run: Path) -> None:
    """Change a ledger line."""
    text = (run / "ledger.jsonl").read_text()
    (run / "ledger.jsonl").write_text(text.replace('"slot":0', '"slot":7', 1))


def test_finished_run_is_read_as_begun(published: Path) -> None:
    """Archives that follow from the ledger are those that the search wrote."""
    beginning = load_begun(published / "run")
    assert beginning is not None
    whole = read_run(published / "run")
    assert replace(beginning[0], directory=whole.directory, archives=whole.archives) == whole


def test_begun_run_ends_with_its_last_whole_generation(begun: Path, published: Path) -> None:
    """What stands behind it is left out; before there is one, there is no run."""
    beginning = load_begun(begun)
    whole = read_run(published / "run")
    assert beginning is not None
    assert beginning[0].generations == whole.generations[:1]
    assert {line.generation for line in beginning[0].candidates} == {0}
    (begun / "ledger.jsonl").write_text("".join((begun / "ledger.jsonl").read_text().splitlines(keepends=True)[:2]))
    assert load_begun(begun) is None


def test_edited_ledger_is_refused(begun: Path) -> None:
    """A live page shows nothing that its search did not decide."""
    edit(begun)
    with refused(RunError, expected="a line that matches its hash"):
        load_begun(begun)


def test_page_follows_a_search_that_ends_and_begins_again(begun: Path, published: Path) -> None:
    """One generation, then files that cannot be read, then all generations."""
    followed = Followed(begun)
    first = followed.now()
    assert ([len(run["generations"]) for run in first.runs], first.commands) == ([1], ())
    assert first.state == "0 of 1 run finished, 0 at work."
    with (begun / "ledger.jsonl").open("a") as ledger:
        ledger.write("torn")  # nothing that is shown
    assert followed.now() == first
    edit(begun)
    second = followed.now()
    assert (second.runs, second.state[:25], followed.is_finished) == (first.runs, "This cannot be read now: ", False)
    shutil.rmtree(begun)
    shutil.copytree(published / "run", begun)
    third = followed.now()
    assert [(len(run["generations"]), len(run["studies"])) for run in third.runs] == [(2, 1)]
    assert (third.state, followed.is_finished) == ("1 of 1 run finished, 0 at work.", True)


@pytest.mark.parametrize("file", ["run.json", "ledger.jsonl"])
def test_what_the_system_refuses_is_said(file: str, begun: Path) -> None:
    """A file that is away or locked for a moment ends nothing."""
    followed = Followed(begun)
    followed.now()
    (begun / file).unlink()
    (begun / file).mkdir()
    contents = followed.now()
    assert contents.state.startswith("This cannot be read now: ")
    assert len(contents.runs) == 1


@pytest.mark.slow
def test_sweep_shows_what_is_begun_of_it(swept: Path, tmp_path: Path) -> None:
    """A job without a directory is waited for; the arms are compared as soon as jobs are finished."""
    sweep = Path(shutil.copytree(swept / "sweep", tmp_path / "sweep"))
    shutil.rmtree(sweep / "none-seed1")
    contents = Followed(sweep).now()
    assert [run["name"] for run in contents.runs] == ["none-seed0", "fixed_temperature-seed0"]
    assert contents.sweep is not None
    assert contents.state == "2 of 3 runs finished, 0 at work."
    for job in sweep.glob("*/run.json"):
        job.write_text(json.dumps({**json.loads(job.read_text()), "digest": None}))
    contents = Followed(sweep).now()
    assert (len(contents.runs), contents.sweep) == (2, None)
    assert contents.state.startswith("0 of 3 runs finished, 0 at work. The arms are not compared yet: ")


def live_in(page: Path) -> bool:
    """Return whether a page reloads itself."""
    live: bool = json.loads(page.read_text().split('id="contents">')[1].split("</script>")[0])["live"]
    return live


def test_interrupted_page_does_not_reload(begun: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It did while it was followed; only it was written."""
    page = tmp_path / "page.html"
    before = sorted(begun.rglob("*"))

    def interrupt(_: float) -> None:
        assert live_in(page)
        raise KeyboardInterrupt

    monkeypatch.setattr("time.sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        follow(begun, page)
    assert not live_in(page)
    assert sorted(begun.rglob("*")) == before


def test_followed_run_that_is_finished_has_the_page_of_a_finished_run(
    published: Path, begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all its tables, and the commands that replay it; before, the page is written once a change."""
    written: list[bool] = []

    def finish(_: float) -> None:
        written.append(live_in(begun / "report.html"))
        shutil.rmtree(begun)
        shutil.copytree(published / "run", begun)

    monkeypatch.setattr("time.sleep", finish)
    assert main(["report", str(begun), "--follow", "--store", str(published / "cache")]) == 0
    assert written == [True]
    assert not live_in(begun / "report.html")
    assert "tacevo replay run --retrain 5" in (begun / "report.html").read_text()


@pytest.mark.parametrize("has_lock", [True, False])
def test_search_that_was_stopped_is_not_waited_for(
    has_lock: bool, begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once no process holds its lock; every writing of the page is told, and the last page does not reload."""
    told: list[str] = []
    waits = iter(range(100))
    with contextlib.ExitStack() as held:
        if has_lock:
            held.enter_context(RunDirectory(begun).locked())
        monkeypatch.setattr("time.sleep", lambda _: held.close() if next(waits) == 5 else None)
        with refused(RunError, place=str(begun), expected="a process at work"):
            follow(begun, begun / "page.html", say=told.append)
    assert next(waits) == (7 if has_lock else 1)
    assert told[0].startswith("written with 1 generation: 0 of 1 run finished")
    assert len(told) == 1 + has_lock
    assert not live_in(begun / "page.html")


def test_what_has_not_begun_is_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A page of something else would wait for ever."""
    Path("conf").mkdir()
    assert main(["report", "conf", "--follow"]) == 2
    assert "conf: expected the directory of a run or a sweep that has begun" in capsys.readouterr().err
