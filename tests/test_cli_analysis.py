"""The commands on finished runs as a user gives them: what they write, what they say, and every mistake in one line."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from smallest import SMALLEST, UNTRACKED

from tacevo.app import main

#: Needs nothing but `make` and a shell.
MAKEFILE = Path(__file__).parent.parent / "Makefile"


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the folder of one tiny search and its study."""
    folder = tmp_path_factory.mktemp("searched")
    sizes = ["search.generations=1", "search.candidates=3", "search.initial=2"]
    where = [f"run.dir={folder / 'run'}", f"store.root={folder / 'store'}"]
    assert main(["search", *SMALLEST, UNTRACKED, *sizes, *where]) == 0
    assert main(["study", f"run={folder / 'run'}", "elites=1", "seeds=4", "epochs=1"]) == 0
    return folder


@pytest.fixture
def run(searched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a copy of the run, to be spoilt, and work beside it."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(searched / "run", tmp_path / "run")
    return Path("run")


def contents(folder: Path) -> dict[str, bytes]:
    """Read all files of a folder."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_tables_are_printed_and_written(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each has its three files; those of the study are among them, and the Markdown is what is printed."""
    assert main(["tables", str(run)]) == 0
    printed, written = capsys.readouterr().out, contents(run / "tables")
    names = {Path(name).stem for name in written}
    assert {
        "generations_force",
        "gate_force",
        "motifs_force",
        "health_force",
        "verdicts_force",
        "scores_force",
    } <= names
    assert set(written) == {f"{name}{ending}" for name in names for ending in (".tex", ".md", ".csv")}
    assert all(content.decode() in printed for name, content in written.items() if name.endswith(".md"))
    assert printed.endswith("tables: run/tables\n")


def test_tables_of_the_paper_need_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Printed values stand beside Holm's; files are written only where -o says so."""
    assert main(["tables", "--paper"]) == 0
    assert "adjusted, Holm" in capsys.readouterr().out
    assert main(["tables", "--paper", "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "published_force.tex").is_file()


def test_tables_of_the_paper_stand_beside_a_run(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a run, its own results are set beside the published ones."""
    assert main(["tables", str(run), "--paper"]) == 0
    assert "Searches of this project beside the published ones" in capsys.readouterr().out


def test_figures_come_in_the_formats_that_were_asked_for(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The samples, the search's and the study's; drawn again, they are the same bytes."""
    assert main(["figures", str(run), "--format", "svg"]) == 0
    first = contents(run / "figures")
    assert {"samples.svg", "network_map.svg", "lineage.svg", "seed_boxes.svg"} <= set(first)
    assert {Path(name).suffix for name in first} == {".svg"}
    assert main(["figures", str(run), "--format", "svg"]) == 0
    assert contents(run / "figures") == first
    assert capsys.readouterr().out.endswith("figures: run/figures\n")


def test_report_is_one_file(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It holds every table and picture, and only it is written."""
    before = contents(run)
    assert main(["report", str(run)]) == 0
    page = (run / "report.html").read_text()
    assert set(contents(run)) - set(before) == {"report.html"}
    assert page.count("<img") >= 10
    assert page.count("<table>") >= 10
    assert json.loads((run / "run.json").read_text())["digest"] in page
    assert capsys.readouterr().out == "report: run/report.html\n"


def test_paper_without_latex_is_a_document(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everything that the document asks for lies beside it, and that there is no PDF is said."""
    monkeypatch.setenv("PATH", os.fspath(run))
    assert main(["paper", str(run), "-o", "out"]) == 0
    said = capsys.readouterr().out
    assert "no PDF: no latexmk or tectonic or pdflatex is installed" in said
    text = Path("out/paper.tex").read_text()
    asked = [part.partition("}")[0] for word in ("\\input{", "graphics{") for part in text.split(word)[1:]]
    assert len(asked) > 20
    assert all((Path("out") / name).is_file() for name in asked)


def test_two_runs_of_one_name_are_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody could tell their chapters apart."""
    assert main(["paper", str(run), f"./{run}"]) == 2
    assert "error: each run needs a folder name of its own; got run twice" in capsys.readouterr().err
    assert not Path("build").exists()


def test_run_without_a_study_is_told_how_to_have_one(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The search's own tables come all the same."""
    shutil.rmtree(run / "studies")
    assert main(["tables", str(run)]) == 0
    told = capsys.readouterr()
    assert "no finished study yet: `tacevo study run=run` makes one" in told.err
    assert "verdicts" not in told.out


def test_study_that_was_edited_is_left_out_and_told(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The exit status is that of a failed check; the search's tables come all the same."""
    (scores,) = run.glob("studies/*/scores.jsonl")
    scores.write_text(scores.read_text().replace('"mse":', '"mse":1', 1))
    assert main(["tables", str(run)]) == 1
    told = capsys.readouterr()
    assert "left out: " in told.err
    assert "scores.jsonl" in told.err
    assert "The generations of run" in told.out


def test_study_of_the_run_before_it_was_continued_is_left_out(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its elites may not be the best any more."""
    more = ["search.generations=2", "search.candidates=3", "search.initial=2"]
    stores = json.loads((run / "run.json").read_text())["config"]["store"]["root"]
    assert main(["search", *SMALLEST, UNTRACKED, *more, f"run.dir={run}", f"store.root={stores}"]) == 0
    assert main(["tables", str(run)]) == 1
    assert "studied the run before it was continued; study it again" in capsys.readouterr().err


def test_data_that_cannot_be_had_cost_the_samples_only(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Other images are never shown as the run's; the reason is said."""
    described = json.loads((run / "run.json").read_text())
    described["data"]["fingerprint"] = "0" * 64
    (run / "run.json").write_text(json.dumps(described))
    assert main(["figures", str(run), "--format", "svg"]) == 0
    assert "no sample images: " in capsys.readouterr().err
    assert not (run / "figures" / "samples.svg").exists()
    assert (run / "figures" / "network_map.svg").exists()


def _cut(run: Path) -> None:
    """Take the last line of the ledger away."""
    lines = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    (run / "ledger.jsonl").write_text("".join(lines[:-1]))


def _remove(run: Path) -> None:
    (run / "run.json").unlink()


@pytest.mark.parametrize("command", ["tables", "figures", "report", "paper"])
@pytest.mark.parametrize(("spoil", "said"), [(_cut, "is not finished"), (_remove, "is not the folder of a run")])
def test_what_is_no_finished_run_is_refused(
    command: str, spoil: Callable[[Path], None], said: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, with status 2, and nothing is written."""
    spoil(run)
    before = contents(Path())
    assert main([command, str(run)]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert said in errors[0]
    assert contents(Path()) == before


def test_tables_of_nothing_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """The message says what is missing."""
    assert main(["tables"]) == 2
    assert "error: tacevo tables needs the folder of a run; or --paper" in capsys.readouterr().err


@pytest.mark.parametrize(("runs", "advice"), [([], "RUNS=runs/NAME"), (["runs/mine"], "RUNS=runs/mine")])
def test_make_paper_says_that_no_run_is_shipped(runs: list[str], advice: str, tmp_path: Path) -> None:
    """It names a run of the user's, if there is one, and builds nothing."""
    shutil.copy(MAKEFILE, tmp_path)
    for name in runs:
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "run.json").write_text("{}")
    done = subprocess.run(["make", "paper"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "no run comes with the project yet" in done.stdout
    assert f"make paper {advice}" in done.stdout
    assert not (tmp_path / ".venv").exists()
