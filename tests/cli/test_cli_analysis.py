"""The tables and figures of finished runs as a user asks for them, and what all such commands refuse in one line."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

import pytest
from bundles import entries_of, members_of, resealed, with_entries
from run_files import contents, study_in

from analysis.report.collection import read_studies
from analysis.report.writing import FURTHER, PAPER
from tacevo.cli.app import main
from tacevo.results.run import read_run
from tacevo.results.study_directory import StudyDirectory
from tacevo.storage.files import in_use

#: Each with the room that it needs.
COMMANDS = [
    "tables",
    pytest.param("figures", marks=pytest.mark.room("figures")),
    pytest.param("report", marks=pytest.mark.room("page")),
    pytest.param("report --latex", marks=pytest.mark.room("document")),
]


@pytest.mark.room("motifs", "alarms", "Pareto", "effects of instructions")
def test_tables_are_printed_and_written(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each has its three files, and is in the index; what is printed is what a paper needs."""
    assert main(["tables", str(run)]) == 0
    printed, written = capsys.readouterr().out, contents(run / "tables")
    index = written.pop("index.md").decode()
    names, study = {name.rpartition(".")[0] for name in written}, study_in(run).name
    assert {
        "gate",
        f"{study}/verdicts",
        "more/generations",
        "more/motifs",
        "more/health",
        f"more/{study}/scores",
    } <= names
    assert set(written) == {f"{name}{ending}" for name in names for ending in (".tex", ".md", ".csv")}
    assert {name.rpartition("/")[2] for name in names} <= PAPER.keys() | FURTHER.keys()  # each with its question
    for name in names:
        assert f"]({name}.md): " in index
        assert (written[f"{name}.md"].decode() in printed) is not name.startswith("more/")
    assert printed.endswith("tables: run/tables (index.md says which question each answers)\n")


@pytest.mark.room("published")
@pytest.mark.slow
def test_tables_of_several_runs_lie_in_a_directory_each(
    run: Path, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Named after the runs, so two of one name are refused; one index leads to all, and no label is there twice."""
    renamed = run.rename("my [run]")
    assert main(["tables", str(renamed), str(bundle)]) == 2
    assert main(["tables", str(renamed), str(renamed), "-o", "out"]) == 2
    assert not Path("out").exists()
    assert main(["tables", str(renamed), str(bundle), "-o", "out", "--paper", "--latex"]) == 0
    printed = capsys.readouterr().out
    assert contents(Path("out/my [run]")).keys() == contents(Path("out/run")).keys()
    places = [unquote(place) for place in re.findall(r"\]\((.*?)\)", Path("out/index.md").read_text())]
    assert {"my [run]/index.md", "run/index.md", "beside_published.md"} <= set(places)
    assert all((Path("out") / place).is_file() for place in places)
    labels = [label for path in Path("out").rglob("*.tex") for label in re.findall(r"\\label{.*?}", path.read_text())]
    assert len(labels) == len(set(labels))
    assert set(re.findall(r"\\label{.*?}", printed)) <= set(labels)


@pytest.mark.room("published")
def test_tables_of_the_paper_need_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Printed values stand beside Holm's; files are written only where -o says so."""
    assert main(["tables", "--paper"]) == 0
    assert "adjusted, Holm" in capsys.readouterr().out
    assert main(["tables", "--paper", "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "published_force.tex").is_file()


@pytest.mark.room("published")
def test_tables_of_the_paper_stand_beside_a_run(run: Path, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a run or a bundle, its results are set beside the published ones."""
    for recorded in (run, bundle):
        assert main(["tables", str(recorded), "--paper", "-o", "out"]) == 0
        assert "Searches of this project beside the published ones" in capsys.readouterr().out
        index = Path("out/index.md").read_text()
        assert all(f"({name}.md)" in index for name in ("gate", "published_force", "beside_published"))


@pytest.mark.parametrize("arguments", [["RUN"], pytest.param(["--paper"], marks=pytest.mark.room("published"))])
def test_tables_that_cannot_be_written_are_not_printed(
    arguments: list[str], run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error would be lost below them; the file stays as it is."""
    Path("file").write_text("mine")
    assert main(["tables", *(word.replace("RUN", str(run)) for word in arguments), "-o", "file"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "file: expected a directory that results can be written to; got one that cannot (File exists)" in told.err
    assert Path("file").read_text() == "mine"


@pytest.mark.parametrize("command", COMMANDS)
def test_store_that_is_no_folder_is_refused(command: str, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped one would be filled with probes and images; nothing is made."""
    before = contents(Path())
    assert main([*command.split(), str(run), "--store", "nowhere"]) == 2
    assert "--store: expected the directory of a run's stores; got nowhere" in capsys.readouterr().err
    assert contents(Path()) == before


@pytest.mark.room("figures")
@pytest.mark.slow
def test_figures_come_in_the_formats_that_were_asked_for(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The samples, the search's and the study's; drawn again, they are the same bytes."""
    assert main(["figures", str(run), "--format", "svg"]) == 0
    first = contents(run / "figures")
    expected = ["samples", "network_map", "lineage", f"{study_in(run).name}/seed_boxes"]
    assert {f"{name}.svg" for name in expected} <= set(first)
    assert {Path(name).suffix for name in first} == {".svg"}
    assert main(["figures", str(run), "--format", "svg"]) == 0
    assert contents(run / "figures") == first
    assert capsys.readouterr().out.endswith("figures: run/figures\n")


@pytest.mark.parametrize(
    ("command", "folder"),
    [("tables", "tables"), pytest.param("figures", "figures", marks=[pytest.mark.slow, pytest.mark.room("figures")])],
)
def test_files_that_a_call_did_not_write_stay(
    command: str, folder: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a study that is refused now, or of another run in the same directory: they are named, and never removed."""
    assert main([command, str(run)]) == 0
    before = contents(run / folder)
    (study_in(run) / "scores.jsonl").write_text("edited")
    capsys.readouterr()
    assert main([command, str(run)]) == 1
    assert contents(run / folder).keys() == before.keys()
    told = capsys.readouterr().err
    for place in {name.rpartition("/")[0] for name in before if f"{study_in(run).name}/" in name}:
        assert f"{run / folder / place}: " in told
    index = run / folder / "index.md"
    assert not index.exists() or study_in(run).name not in index.read_text()
    assert "left out: " in told
    assert "scores.jsonl" in told
    assert "no finished study yet" not in told


def test_edited_candidate_costs_the_motifs_only(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The reason is printed, and all other tables are written."""
    path = run / "candidates" / "g00s00.py"
    path.write_text(path.read_text() + "# edited\n")
    assert main(["tables", str(run)]) == 0
    told = capsys.readouterr()
    assert "no table of motifs: " in told.err
    assert "g00s00.py" in told.err
    assert (run / "tables" / "gate.md").exists()
    assert not (run / "tables" / "more" / "motifs.md").exists()


def test_study_that_still_runs_is_left_out_as_such(run: Path) -> None:
    """And once no process is at work on it, as one that can be continued."""
    study = StudyDirectory(study_in(run))
    study.scores.unlink()
    with in_use(study.path):
        (told,) = read_studies(read_run(run)).left_out
    assert "one that is still running; wait for it" in told
    (told,) = read_studies(read_run(run)).left_out
    assert "still running" not in told
    assert "continues it" in told


def _cut(run: Path) -> None:
    """Take the last line of the ledger away."""
    lines = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    (run / "ledger.jsonl").write_text("".join(lines[:-1]))


def _remove(run: Path) -> None:
    (run / "run.json").unlink()


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("spoil", "said"),
    [(_cut, "is not finished"), (_remove, "run.json"), (shutil.rmtree, "got a path that does not exist")],
)
def test_what_is_no_finished_run_is_refused(
    command: str, spoil: Callable[[Path], None], said: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, with status 2, and nothing is written."""
    spoil(run)
    before = contents(Path())
    assert main([*command.split(), str(run)]) == 2
    (error,) = (line for line in capsys.readouterr().err.splitlines() if not line.startswith("reading "))
    assert said in error
    assert contents(Path()) == before


@pytest.mark.parametrize(
    ("command", "results"),
    [
        ("tables", "out"),
        pytest.param("figures", "out", marks=[pytest.mark.slow, pytest.mark.room("figures")]),
    ],
)
def test_published_run_gives_what_its_folder_gives(command: str, results: str, run: Path, bundle: Path) -> None:
    """A bundle is read like the directory it was made from, the study with it, and nothing is written beside it."""
    beside = set(bundle.parent.iterdir())
    assert main([command, str(run), "-o", f"folder-{results}"]) == 0
    assert main([command, str(bundle), "-o", f"bundle-{results}"]) == 0
    whole = Path(f"folder-{results}"), Path(f"bundle-{results}")
    folder, published = map(contents, whole)
    assert published == folder
    assert set(bundle.parent.iterdir()) == beside


def test_no_code_of_a_published_candidate_runs(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A probe that a bundle lacks is missed, not made: its author chose the walls."""
    members = members_of(bundle)
    entries = [entry for entry in entries_of(members) if entry["kind"] != "probes"]
    stripped = resealed(with_entries(members, entries), tmp_path / "stripped.zip")
    assert main(["tables", str(stripped), "-o", str(tmp_path / "out")]) == 0
    assert "no table of motifs" in capsys.readouterr().err
    assert not (tmp_path / "out" / "more" / "motifs.md").exists()
