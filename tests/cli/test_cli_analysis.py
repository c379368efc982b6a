"""The commands on finished runs as a user gives them: what they write, what they say, and every mistake in one line."""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bundles import entries_of, members_of, resealed, with_entries
from smallest import SMALLEST, UNTRACKED

from tacevo.cli.app import main


def study_of(run: Path) -> Path:
    """Return the directory of the only study of a run."""
    (path,) = run.glob("studies/*")
    return path


@pytest.fixture
def bundle(published: Path) -> Path:
    """Return the run and its study as one published file."""
    return published / "run.zip"


def contents(folder: Path) -> dict[str, bytes]:
    """Read all files of a directory."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_tables_are_printed_and_written(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each has its three files; those of the study are among them, and the Markdown is what is printed."""
    assert main(["tables", str(run)]) == 0
    printed, written = capsys.readouterr().out, contents(run / "tables")
    names, study = {Path(name).stem for name in written}, study_of(run).name
    of_study = {f"verdicts_force_{study}", f"scores_force_{study}"}
    assert {"generations_force", "gate_force", "motifs_force", "health_force", *of_study} <= names
    assert set(written) == {f"{name}{ending}" for name in names for ending in (".tex", ".md", ".csv")}
    assert all(content.decode() in printed for name, content in written.items() if name.endswith(".md"))
    assert printed.endswith("tables: run/tables\n")


def test_tables_of_the_paper_need_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Printed values stand beside Holm's; files are written only where -o says so."""
    assert main(["tables", "--paper"]) == 0
    assert "adjusted, Holm" in capsys.readouterr().out
    assert main(["tables", "--paper", "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "published_force.tex").is_file()


def test_tables_of_the_paper_stand_beside_a_run(run: Path, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a run or a bundle, its results are set beside the published ones; its studies are not, and are not read."""
    (study_of(run) / "scores.jsonl").write_text("damaged")
    for recorded in (run, bundle):
        assert main(["tables", str(recorded), "--paper"]) == 0
        told = capsys.readouterr()
        assert "Searches of this project beside the published ones" in told.out
        assert told.err == ""


@pytest.mark.parametrize("arguments", [["RUN"], ["--paper"]])
def test_tables_that_cannot_be_written_are_not_printed(
    arguments: list[str], run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error would be lost below them; the file stays as it is."""
    Path("file").write_text("mine")
    assert main(["tables", *(word.replace("RUN", str(run)) for word in arguments), "-o", "file"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "file: expected a directory that results can be written to; got File exists" in told.err
    assert Path("file").read_text() == "mine"


@pytest.mark.parametrize("command", ["tables", "figures", "report", "paper"])
def test_store_that_is_no_folder_is_refused(command: str, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped one would be filled with probes and images; nothing is made."""
    before = contents(Path())
    assert main([command, str(run), "--store", "nowhere"]) == 2
    assert "--store: expected the directory of a run's stores; got nowhere" in capsys.readouterr().err
    assert contents(Path()) == before


def test_figures_come_in_the_formats_that_were_asked_for(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The samples, the search's and the study's; drawn again, they are the same bytes."""
    assert main(["figures", str(run), "--format", "svg"]) == 0
    first = contents(run / "figures")
    expected = ["samples_force", "network_map_force", "lineage_force", f"seed_boxes_force_{study_of(run).name}"]
    assert {f"{name}.svg" for name in expected} <= set(first)
    assert {Path(name).suffix for name in first} == {".svg"}
    assert main(["figures", str(run), "--format", "svg"]) == 0
    assert contents(run / "figures") == first
    assert capsys.readouterr().out.endswith("figures: run/figures\n")


@pytest.mark.parametrize(
    ("command", "folder"), [("tables", "tables"), pytest.param("figures", "figures", marks=pytest.mark.slow)]
)
def test_what_was_written_of_a_study_goes_with_it(
    command: str, folder: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table of a study that is refused now would look current; the files of the user and other tasks stay."""
    assert main([command, str(run)]) == 0
    own = run / folder / f"verdicts_grating_{study_of(run).name}.md"
    own.write_text("of another run's task")
    (run / folder / "notes_force.md").write_text("mine")
    before = set(contents(run / folder))
    assert main([command, str(run)]) == 0
    assert set(contents(run / folder)) == before
    (study_of(run) / "scores.jsonl").write_text("edited")
    capsys.readouterr()
    assert main([command, str(run)]) == 1
    gone = before - set(contents(run / folder))
    assert gone
    assert gone == {name for name in before if f"_force_{study_of(run).name}." in name}
    told = capsys.readouterr().err
    assert all(f"removed {name}: its study is missing or left out" in told for name in gone)


def test_edited_candidate_costs_the_motifs_only(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The reason is printed, and all other tables are written."""
    path = run / "candidates" / "g00s00.py"
    path.write_text(path.read_text() + "# edited\n")
    assert main(["tables", str(run)]) == 0
    told = capsys.readouterr()
    assert "no tables of motifs: " in told.err
    assert "g00s00.py" in told.err
    assert "The generations of run" in told.out
    assert "Motifs of" not in told.out


def shown_in(page: Path) -> Any:
    """Read the contents that lie in a page."""
    found = re.search(r'<script type="application/json" id="contents">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_report_is_one_file(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It holds the run's digest, its tables and its study, and only it is written."""
    before = contents(run)
    assert main(["report", str(run)]) == 0
    shown = shown_in(run / "report.html")
    assert set(contents(run)) - set(before) == {"report.html"}
    (only,) = shown["runs"]
    assert json.loads((run / "run.json").read_text())["digest"] in only["headlines"][2]
    assert len(only["tables"]) >= 10
    assert only["samples"].startswith("data:image/png;base64,")
    assert len(only["studies"]) == 1
    assert shown["commands"] == ["tacevo replay run", "tacevo replay run --retrain 5"]
    assert re.search("[0-9a-f]{64}", str(shown["checked"])) is None  # it has no manifest that it was compared with
    assert capsys.readouterr().out == "report: run/report.html\n"


def test_report_of_a_bundle_names_the_bundle(bundle: Path, tmp_path: Path) -> None:
    """No private directory enters the page; its digest does, because every file was compared with the manifest."""
    assert main(["report", str(bundle), "-o", str(tmp_path / "page.html")]) == 0
    page = (tmp_path / "page.html").read_text()
    shown = shown_in(tmp_path / "page.html")
    assert (shown["title"], shown["commands"][0]) == ("run.zip", "tacevo replay run.zip")
    digest = hashlib.sha256(members_of(bundle)["manifest-sha256.txt"]).hexdigest()
    assert sum(digest in line for line in shown["checked"]) == 1
    assert str(bundle.parent) not in page
    assert "/tmp/tacevo-" not in page


def test_report_does_not_say_where_the_run_lay(published: Path, tmp_path: Path) -> None:
    """Nor where its stores are: a page can lie beside a paper. Both are named where something is missing."""
    run = Path(shutil.copytree(published / "run", tmp_path / "run"))
    stores = tmp_path / "stores"
    stores.mkdir()
    assert main(["report", str(run), "--store", str(stores)]) == 0
    page = run / "report.html"
    assert any("its stores: expected" in remark for remark in shown_in(page)["runs"][0]["remarks"])
    assert str(tmp_path) not in page.read_text()
    shutil.rmtree(run / "studies")
    assert main(["report", str(run)]) == 0
    assert any("`tacevo study run=run`" in remark for remark in shown_in(page)["runs"][0]["remarks"])
    assert str(tmp_path) not in page.read_text()


def test_report_of_a_sweep_compares_its_arms(swept: Path, tmp_path: Path) -> None:
    """Each run comes with its candidates; sources that runs share come once."""
    page = tmp_path / "page.html"
    assert main(["report", str(swept / "sweep.zip"), "-o", str(page)]) == 0
    shown = shown_in(page)
    assert [arm["name"] for arm in shown["sweep"]["arms"]] == ["none", "fixed_temperature"]
    assert len(shown["runs"]) == 3
    used = {one["source"] for run in shown["runs"] for one in run["candidates"]} - {None}
    assert set(shown["sources"]) == used
    for run in shown["runs"]:
        assert len(run["tables"]) >= 10
        assert run["remarks"][-1] == "no study: it was published without one"


def test_report_of_arms_that_cannot_be_compared_says_why(swept: Path, tmp_path: Path) -> None:
    """Its runs are there all the same."""
    sweep = shutil.copytree(swept / "sweep", tmp_path / "sweep")
    record = json.loads((sweep / "none-seed0" / "run.json").read_text())
    record["versions"]["torch"] = "0.1"
    (sweep / "none-seed0" / "run.json").write_text(json.dumps(record))
    store = str(swept / "cache")
    assert main(["report", str(sweep), "--store", store, "-o", str(tmp_path / "page.html")]) == 0
    shown = shown_in(tmp_path / "page.html")
    assert (shown["sweep"], len(shown["runs"])) == (None, 3)
    assert "the arms are not compared: sweep, version of torch: " in shown["state"], shown["state"]


def test_report_of_the_working_directory_has_its_name(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`.` is not a name that could be replayed from elsewhere."""
    monkeypatch.chdir(run)
    assert main(["report", ".", "-o", "page.html"]) == 0
    shown = shown_in(Path("page.html"))
    assert (shown["title"], shown["commands"][0]) == (run.resolve().name, f"tacevo replay {run.resolve().name}")


def test_report_of_a_moved_sweep_takes_the_named_store(
    swept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its runs and its arms are both read with it."""
    sweep = shutil.copytree(swept / "sweep", tmp_path / "sweep")
    store = shutil.copytree(swept / "cache", tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(sweep), "--store", str(store)]) == 0
    assert len(shown_in(sweep / "report.html")["sweep"]["arms"]) == 2


@pytest.mark.slow
def test_paper_without_latex_is_a_document(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everything that the document asks for lies beside it, and that there is no PDF is said."""
    monkeypatch.setenv("PATH", os.fspath(run))
    assert main(["paper", str(run), "-o", "out"]) == 0
    said = capsys.readouterr().out
    assert "no PDF: install latexmk or tectonic or pdflatex" in said
    text = Path("out/paper.tex").read_text()
    asked = [part.partition("}")[0] for word in ("\\input{", "graphics{") for part in text.split(word)[1:]]
    assert len(asked) > 20
    assert all((Path("out") / name).is_file() for name in asked)


@pytest.mark.slow
def test_paper_takes_the_largest_study_of_a_run(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A first, quick study does not stand beside the one that counts; which is passed over is said."""
    run = Path("run")
    monkeypatch.setenv("PATH", os.fspath(run))
    quick = study_of(run).name
    assert main(["study", f"run={run}", "elites=1", "seeds=5", "epochs=1"]) == 0
    assert main(["paper", str(run), "-o", "out"]) == 0
    assert f"passed over: {quick}; the paper takes the run's largest study, elites1-seeds5-" in capsys.readouterr().err
    names = set(contents(Path("out")))
    assert not any(quick in name for name in names)
    assert any("verdicts_force_elites1-seeds5-" in name for name in names)


@pytest.mark.slow
def test_paper_refuses_studies_that_were_made_otherwise(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two runs of one task, studied with unlike numbers of seeds: the rows are named, and nothing is written."""
    run = Path("run")
    monkeypatch.setenv("PATH", os.fspath(run))
    other = Path(shutil.copytree(run, "other"))
    shutil.rmtree(other / "studies")
    assert main(["study", f"run={other}", "elites=1", "seeds=5", "epochs=1"]) == 0
    assert main(["paper", str(run), str(other), "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert "the studies of force, seeds: expected 4 as for baseline, variant 1 of run" in said
    assert not Path("out").exists()


def test_two_runs_of_one_name_are_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Their chapters would have one title."""
    assert main(["paper", str(run), f"./{run}"]) == 2
    assert "expected runs with different directory names; got run twice" in capsys.readouterr().err
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
    assert "no finished study yet" not in told.err
    assert "The generations of run" in told.out


@pytest.mark.slow
def test_study_of_the_run_before_it_was_continued_is_left_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its elites may not be the best any more."""
    run = Path("run")
    more = ["search.generations=2", "search.candidates=3", "search.initial=2"]
    stores = json.loads((run / "run.json").read_text())["config"]["store"]["root"]
    assert main(["search", *SMALLEST, UNTRACKED, *more, f"run.dir={run}", f"store.root={stores}"]) == 0
    assert main(["tables", str(run)]) == 1
    assert ", before it was continued; study it again" in capsys.readouterr().err


def test_data_that_cannot_be_had_cost_the_samples_only(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Other images are never shown as the run's; the reason is said."""
    described = json.loads((run / "run.json").read_text())
    described["data"]["fingerprint"] = "0" * 64
    (run / "run.json").write_text(json.dumps(described))
    assert main(["figures", str(run), "--format", "svg"]) == 0
    assert "no sample images: " in capsys.readouterr().err
    assert not (run / "figures" / "samples_force.svg").exists()
    assert (run / "figures" / "network_map_force.svg").exists()
    assert main(["report", str(run), "-o", "page.html"]) == 0
    assert any("no sample images: " in remark for remark in shown_in(Path("page.html"))["runs"][0]["remarks"])


def _cut(run: Path) -> None:
    """Take the last line of the ledger away."""
    lines = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    (run / "ledger.jsonl").write_text("".join(lines[:-1]))


def _remove(run: Path) -> None:
    (run / "run.json").unlink()


@pytest.mark.parametrize("command", ["tables", "figures", "report", "paper"])
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
    assert main([command, str(run)]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert said in errors[0]
    assert contents(Path()) == before


def test_tables_of_nothing_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """The message says what is missing."""
    assert main(["tables"]) == 2
    assert "error: tacevo tables: expected the directory or bundle of a run, or --paper" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "results"),
    [
        ("tables", "out"),
        pytest.param("figures", "out", marks=pytest.mark.slow),
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


@pytest.mark.parametrize("command", ["tables", "figures", "report"])
def test_published_run_takes_no_results(
    command: str, run: Path, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is one file: the user says where they go."""
    assert main([command, str(bundle)]) == 2
    assert "name by -o where" in capsys.readouterr().err


@pytest.mark.slow
def test_paper_takes_published_runs(run: Path, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A directory and a bundle; two of one name are refused, and one run under two names is one search."""
    renamed = run.rename("renamed")
    assert main(["paper", str(renamed), str(bundle), "-o", "pages"]) == 0
    assert {path.name for path in Path("pages").iterdir()} >= {"run1", "run2", "paper.tex"}
    assert f"{bundle.stem} is not beside the other runs of force: expected another search" in capsys.readouterr().err
    assert main(["paper", str(bundle), str(bundle), "-o", "twice"]) == 2
    assert not Path("twice").exists()


def test_no_code_of_a_published_candidate_runs(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A probe that a bundle lacks is missed, not made: its author chose the walls."""
    members = members_of(bundle)
    entries = [entry for entry in entries_of(members) if entry["kind"] != "probes"]
    stripped = resealed(with_entries(members, entries), tmp_path / "stripped.zip")
    assert main(["tables", str(stripped), "-o", str(tmp_path / "out")]) == 0
    assert "no tables of motifs" in capsys.readouterr().err
    assert not (tmp_path / "out" / "motifs_force.md").exists()
