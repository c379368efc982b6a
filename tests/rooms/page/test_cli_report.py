"""The report page and the paper as a user asks for them: what is written, what is said, and what is refused."""

import hashlib
import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bundles import members_of
from run_files import contents, study_in

from tacevo.cli.app import main
from tacevo.config.schema import RunConfig
from tacevo.data.dataset import Dataset
from tacevo.records import DataFacts
from tacevo.runs.datasets import load_same


def shown_in(page: Path) -> Any:
    """Read the contents that lie in a page."""
    contents = re.search(r'<script type="application/json" id="contents">(.*?)</script>', page.read_text(), re.DOTALL)
    assert contents is not None
    return json.loads(contents[1])


def test_report_is_one_file(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It holds the run's digest, its tables and its study, and only it is written."""
    before = contents(run)
    assert main(["report", str(run)]) == 0
    shown = shown_in(run / "report.html")
    assert set(contents(run)) - set(before) == {"report.html"}
    (only,) = shown["runs"]
    assert json.loads((run / "run.json").read_text())["digest"] in only["headlines"][-1]
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
    assert any("`tacevo study run`" in remark for remark in shown_in(page)["runs"][0]["remarks"])
    assert str(tmp_path) not in page.read_text()


@pytest.mark.room("publishing")
def test_report_of_a_sweep_compares_its_arms(swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each run comes with its candidates, and is told as it begins; sources that runs share come once."""
    page = tmp_path / "page.html"
    assert main(["report", str(swept / "sweep.zip"), "-o", str(page)]) == 0
    assert re.findall(r"\((\d of \d)\)", capsys.readouterr().err) == ["1 of 3", "2 of 3", "3 of 3"]
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


def test_report_of_a_sweep_that_is_not_finished_names_what_is_missing(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The finished jobs are shown and compared; no path enters the page."""
    sweep = shutil.copytree(swept / "sweep", tmp_path / "sweep")
    shutil.rmtree(sweep / "none-seed1")
    command = ["report", str(sweep), "--store", str(swept / "cache"), "-o", str(tmp_path / "page.html")]
    assert main(command) == 0
    assert "left out: none-seed1: not begun" in capsys.readouterr().err.splitlines()
    shown = shown_in(tmp_path / "page.html")
    assert ([arm["name"] for arm in shown["sweep"]["arms"]], len(shown["runs"])) == (["none", "fixed_temperature"], 2)
    assert shown["state"] == "left out: none-seed1: not begun"


def test_report_of_the_working_directory_has_its_name(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`.` is not a name that could be replayed from elsewhere."""
    monkeypatch.chdir(run)
    assert main(["report", ".", "-o", "page.html"]) == 0
    shown = shown_in(Path("page.html"))
    assert (shown["title"], shown["commands"][0]) == (run.resolve().name, f"tacevo replay {run.resolve().name}")


@pytest.mark.slow
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
    assert main(["report", "--latex", str(run), "-o", "out"]) == 0
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
    quick = study_in(run).name
    assert main(["study", f"run={run}", "elites=1", "seeds=5", "epochs=1"]) == 0
    assert main(["report", "--latex", str(run), "-o", "out"]) == 0
    assert (
        f"passed over: {quick}; the document takes the run's largest study on each data set" in capsys.readouterr().err
    )
    names = set(contents(Path("out")))
    assert not any(quick in name for name in names)
    assert any("elites1-seeds5-" in name and "verdicts" in name for name in names)


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
    assert main(["report", "--latex", str(run), str(other), "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert "the studies of force, seeds: expected 4 as for baseline, variant 1 of run" in said
    assert not Path("out").exists()


@pytest.mark.slow
def test_data_that_cannot_be_had_cost_the_samples_only(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other images are never shown as the run's; the reason is said."""

    def other(config: RunConfig, facts: DataFacts, *arguments: Any, **options: Any) -> Dataset:
        return load_same(config, replace(facts, fingerprint="0" * 64), *arguments, **options)

    monkeypatch.setattr("tacevo.runs.data_check.load_same", other)
    assert main(["figures", str(run), "--format", "svg"]) == 0
    assert "no sample images: " in capsys.readouterr().err
    assert not (run / "figures" / "samples.svg").exists()
    assert (run / "figures" / "network_map.svg").exists()
    assert main(["report", str(run), "-o", "page.html"]) == 0
    assert any("no sample images: " in remark for remark in shown_in(Path("page.html"))["runs"][0]["remarks"])


@pytest.mark.slow
def test_paper_takes_published_runs(run: Path, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A directory and a bundle; one run under two names is one search."""
    renamed = run.rename("renamed")
    assert main(["report", "--latex", str(renamed), str(bundle), "-o", "pages"]) == 0
    assert {path.name for path in Path("pages").iterdir()} >= {"run1", "run2", "paper.tex"}
    assert f"{bundle.stem} is not beside the other runs of force: expected another search" in capsys.readouterr().err
