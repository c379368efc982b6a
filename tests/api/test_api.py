"""Promise: what was recorded can be had from Python as it was recorded, and what trains does what the commands do."""

import gc
import json
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from checkout import ROOT
from pandas.testing import assert_frame_equal
from refusals import refused
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED

import tacevo
from analysis.sweeps.ablation import Ablation
from analysis.sweeps.arm_metrics import Metric
from tacevo.api import frames
from tacevo.api.sweeps import metric_of
from tacevo.cli.app import main
from tacevo.errors import ConfigError

BUNDLES = sorted((ROOT / "cache" / "published").glob("*.zip"))


@pytest.fixture(scope="module")
def opened(published: Path) -> tacevo.Run:
    """Open the session's published run."""
    run = tacevo.open(published / "run.zip")
    assert isinstance(run, tacevo.Run)
    return run


@pytest.mark.room("table", "page", "mlflow", "export")
def test_public_names_are_frozen() -> None:
    """A program that was written for them goes on."""
    assert tacevo.__all__ == [
        "BundleError",
        "CacheMissError",
        "ConfigError",
        "DivergenceError",
        "Run",
        "RunError",
        "Study",
        "Sweep",
        "Table",
        "TacevoError",
        "check",
        "check_data",
        "extend",
        "noise",
        "open",
        "open_table",
        "plan",
        "publish",
        "search",
        "study",
    ]
    assert all(callable(getattr(tacevo, name)) for name in tacevo.__all__)
    with pytest.raises(AttributeError, match="serach"):
        tacevo.serach  # noqa: B018


def test_import_is_light() -> None:
    """Neither torch nor pandas nor Matplotlib is imported before it is needed."""
    script = "import sys, tacevo; print({'torch', 'pandas', 'matplotlib', 'hydra', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_candidates_are_the_ledgers(opened: tacevo.Run, published: Path) -> None:
    """Field by field, as the lines of the file say."""
    lines = [json.loads(text) for text in (published / "run" / "ledger.jsonl").read_text().splitlines()]
    lines = [line for line in lines if line["kind"] == "candidate"]
    frame = opened.candidates
    assert [*frame.index] == [line["id"] for line in lines]
    for name in ("generation", "slot", "operator", "stage", "reason", "parameters", "flops", "niche", "arch_div"):
        recorded = [line.get(name) for line in lines]
        assert [None if pd.isna(value) else value for value in frame[name]] == recorded
    assert [[*parents] for parents in frame["parents"]] == [line["parents"] for line in lines]
    assert frame["recorded_fitness"].isna().tolist() == [line.get("fitness") is None for line in lines]


def test_elites_are_the_archives(opened: tacevo.Run, published: Path) -> None:
    """Best first, and each is marked among the candidates."""
    elites = json.loads((published / "run" / "archive.json").read_text())["elites"]
    frame = opened.elites
    assert {niche: (row["id"], row["fitness"]) for niche, row in frame.iterrows()} == {
        elite["niche"]: (elite["id"], elite["fitness"]) for elite in elites
    }
    assert frame["fitness"].is_monotonic_increasing
    assert {*opened.candidates.index[opened.candidates["is_elite"]]} == {elite["id"] for elite in elites}


def test_frames_are_equal_from_directory_and_bundle(opened: tacevo.Run, published: Path) -> None:
    """Where a run lies changes nothing of it."""
    other = tacevo.open(published / "run")
    assert isinstance(other, tacevo.Run)
    for name in ("candidates", "generations", "elites", "prompts"):
        assert_frame_equal(getattr(opened, name), getattr(other, name))
    assert opened.digest == other.digest
    (ours,), (theirs,) = opened.studies, other.studies
    for name in ("networks", "scores", "verdicts", "reestimates"):
        assert_frame_equal(getattr(ours, name), getattr(theirs, name))


@pytest.mark.room("Pareto")
def test_front_is_of_the_objectives_that_are_asked_for(opened: tacevo.Run, published: Path) -> None:
    """Among them a cost of one's own, which only some candidates have; what was studied counts by its other seeds."""
    from analysis.runs.pareto import PARETO

    directory = tacevo.open(published / "run")
    assert isinstance(directory, tacevo.Run)
    assert_frame_equal(opened.pareto(), directory.pareto())
    front = opened.pareto(["fitness", "flops"])
    assert {name: str(dtype) for name, dtype in front.dtypes.items()} == PARETO
    assert front["fitness"].is_monotonic_increasing
    assert front["flops"].is_monotonic_decreasing
    (smallest,) = opened.pareto(["parameters", "flops"]).index[:1]
    assert opened.candidates.loc[smallest, "parameters"] == opened.candidates["parameters"].min()
    studied = [*opened.studies[0].networks["id"]]
    timed = opened.pareto(["fitness", pd.Series([3, 4], studied, name="ms")])
    medians = opened.studies[0].reestimates.groupby("id")["fitness"].median()
    assert {*timed.index} <= {*studied}
    assert timed["fitness"].to_dict() == pytest.approx(medians[timed.index].to_dict())
    assert (str(timed["ms"].dtype), {*timed["estimate"]}) == ("float64", {"re-estimated"})


@pytest.mark.room("Pareto")
@pytest.mark.parametrize(
    "objectives",
    [
        ["fitness"],
        ["fitness", "fitness"],
        ["fitness", "flop"],
        ["fitness", pd.Series({"g00s00": 1.0})],
        ["fitness", pd.Series({"g00s00": 1.0}, name="flops")],
        ["fitness", pd.Series([1.0, 2.0], ["g00s00", "g00s00"], name="ms")],
        ["fitness", pd.Series({"g99s99": 1.0}, name="ms")],
        ["fitness", pd.Series({"g00s00": "slow"}, name="ms")],
    ],
)
def test_what_is_no_objective_is_refused(objectives: list[Any], opened: tacevo.Run) -> None:
    """Too few, twice, misspelt, without a name of its own, or not numbers of trained candidates."""
    with refused(ConfigError, place="objectives"):
        opened.pareto(objectives)


@pytest.mark.few(2)
@pytest.mark.parametrize("bundle", BUNDLES, ids=lambda path: path.stem)
def test_every_published_bundle_can_be_looked_into(bundle: Path) -> None:
    """All frames have their columns, all tables become frames, and a picture is drawn."""
    opened = tacevo.open(bundle)
    if isinstance(opened, tacevo.Sweep):
        assert [*opened.jobs.columns][: len(frames.JOBS) - 1] == [*frames.JOBS][1:]
        contrasts = opened.contrasts()
        assert [*contrasts.index] == [*dict.fromkeys([contrasts.index[0], *opened.arms])]
    run = opened.run(opened.jobs.index[0]) if isinstance(opened, tacevo.Sweep) else opened
    assert [*run.candidates.columns] == [*frames.CANDIDATES][1:]
    assert {str(dtype) for dtype in run.candidates.dtypes} <= {"Int64", "float64", "str", "boolean", "object"}
    assert run.candidates.loc[run.elites["id"], "fitness"].notna().all()
    for table in run.tables.values():
        assert len(table.frame.columns) >= 1
    for study in run.studies:
        assert len(study.scores) >= len(study.networks)
        assert {*study.verdicts.index} <= {*study.networks.index}


def test_every_column_has_values() -> None:
    """Of a whole search, a column is missing throughout only where nothing of its kind happened."""
    run = tacevo.open(ROOT / "cache" / "published" / "grating-grammar.zip")
    assert isinstance(run, tacevo.Run)
    study = run.studies[0]
    shown = [run.candidates, run.generations, run.elites, run.prompts]
    shown += [study.networks, study.scores, study.verdicts, study.reestimates]
    missing = {name for frame in shown for name in frame.columns[frame.isna().all()]}
    assert missing == {"cpu_seconds", "repaired", "skipped", "failed", "level", "effort", "model"}
    assert not any(frame.index.isna().any() for frame in shown)


@pytest.mark.room("figures")
def test_what_a_command_writes_can_be_had(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every table, byte for byte, and the summary but for marks of Markdown; a study's table by its own name, too."""
    assert main(["tables", "run"]) == 0
    made = tacevo.open("run")
    assert isinstance(made, tacevo.Run)
    written = {path.read_text() for path in (run / "tables").rglob("*.tex")}
    assert {table.to_latex() for table in made.tables.values()} == written
    (study,) = made.studies
    assert study.tables["verdicts"].to_markdown() == made.tables[f"{study.name}/verdicts"].to_markdown()
    assert made.tables["verdicts"].to_markdown() in capsys.readouterr().out
    assert main(["show", "run"]) == 0
    shown, summary = (re.sub(r"[\\`*]", "", text) for text in (capsys.readouterr().out, made.summary))
    assert shown.startswith(summary)
    assert next(iter(made.figures)) == "samples"


@pytest.mark.room("figures")
def test_figures_show_themselves_in_a_notebook(opened: tacevo.Run) -> None:
    """By IPython's own rule, whatever a user's Matplotlib is set to; each that a run without its images has."""
    for name, draw in opened.figures.items():
        if name != "samples":
            assert draw()._repr_png_().startswith(b"\x89PNG"), name  # type: ignore[attr-defined]


def test_unknown_table_is_answered_with_the_near_one(opened: tacevo.Run) -> None:
    """As every misspelt name."""
    with refused(tacevo.ConfigError, place="run.tables", remedy="did you mean verdicts?"):
        opened.tables["verdict"]
    assert "verdict" not in opened.tables


def test_source_runs_as_a_file(opened: tacevo.Run, tmp_path: Path) -> None:
    """With the imports that the sandbox gave it."""
    (tmp_path / "net.py").write_text(opened.source(opened.elites["id"].iloc[-1]))
    subprocess.run([sys.executable, tmp_path / "net.py"], check=True)


def test_network_is_built_only_for_who_trusts_it(opened: tacevo.Run) -> None:
    """Its weights follow from torch's seed, and it maps images to outputs."""
    import torch

    name = opened.elites["id"].iloc[0]
    with refused(tacevo.ConfigError, expected="trust=True: ", remedy=f"read run.source({name!r}) first"):
        opened.network(name)
    contract = opened.recorded.record.task.contract
    images = torch.zeros(2, contract.in_channels, contract.image_size, contract.image_size)
    outputs = []
    for seed in (3, 3, 4):
        torch.manual_seed(seed)
        with torch.no_grad():
            outputs.append(opened.network(name, trust=True).eval()(images))
    assert outputs[0].shape == (2, contract.outputs)
    assert torch.equal(outputs[0], outputs[1])
    assert not torch.equal(outputs[0], outputs[2])


@pytest.mark.parametrize("name", ["g99s99", "../../run", ""])
def test_candidate_that_is_not_there_is_refused(opened: tacevo.Run, name: str) -> None:
    """Also where it looks like a path."""
    with refused(tacevo.ConfigError, place="candidate", got=repr(name)):
        opened.source(name)


def test_edited_source_is_refused(run: Path) -> None:
    """Before anything of it is built."""
    made = tacevo.open("run")
    assert isinstance(made, tacevo.Run)
    name = made.elites["id"].iloc[0]
    (run / "candidates" / f"{name}.py").write_text("raise SystemExit")
    for read in (made.source, lambda name: made.network(name, trust=True)):
        with refused(tacevo.RunError, place=f"run/candidates/{name}.py"):
            read(name)


@pytest.mark.parametrize("place", ["nothing", ".", "file.zip"])
def test_what_is_no_run_is_refused(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by every command."""
    monkeypatch.chdir(tmp_path)
    Path("file.zip").write_bytes(b"none")
    with pytest.raises(tacevo.TacevoError):
        tacevo.open(place)


def test_edited_run_does_not_replay(folder: Path) -> None:
    """The first difference is raised; the same run unedited gives its digest."""
    made = tacevo.open("run")
    assert isinstance(made, tacevo.Run)
    assert made.replay(quiet=True) == made.digest
    (Path("run") / "summary.md").write_text("best of all\n")
    with pytest.raises(tacevo.DivergenceError):
        made.replay(quiet=True)


def test_job_of_a_sweep_outlives_the_sweep_object(swept: Path) -> None:
    """The bundle stays open as long as a run of it is used."""
    sweep = tacevo.open(swept / "sweep.zip")
    assert isinstance(sweep, tacevo.Sweep)
    run = sweep.run(sweep.jobs.index[0])
    known = run.candidates
    del sweep
    gc.collect()
    assert run.source(run.elites["id"].iloc[0])
    assert_frame_equal(run.candidates, known)


def test_sweep_is_the_same_from_directory_and_bundle(swept: Path) -> None:
    """Jobs, arms and contrasts; an unknown metric is refused."""
    one, other = tacevo.open(swept / "sweep"), tacevo.open(swept / "sweep.zip")
    assert isinstance(one, tacevo.Sweep)
    assert isinstance(other, tacevo.Sweep)
    assert_frame_equal(one.jobs, other.jobs)
    assert_frame_equal(one.contrasts("coverage"), other.contrasts("coverage"))
    assert {*one.tables} == {*other.tables}
    with refused(tacevo.ConfigError, place="metric", remedy="did you mean coverage?"):
        one.contrasts("coverag")
    with refused(tacevo.ConfigError, place="metric", got="'test_score'", remedy="tacevo study sweep="):
        one.contrasts("test_score")


@pytest.mark.room("plans, pilots")
def test_plan_is_of_one_study_where_a_run_has_several() -> None:
    """They may not be of one kind; what is no pilot is refused by name."""
    run = tacevo.open(ROOT / "cache" / "published" / "grating-claude.zip")
    assert isinstance(run, tacevo.Run)
    with refused(tacevo.RunError, expected="full trainings of one kind"):
        tacevo.plan("study", run, effect=0.2)
    seeds = [set(tacevo.plan("study", study, effect=0.2).frame["seeds"]) for study in run.studies]
    assert len(seeds) == 2
    assert seeds[0] != seeds[1]
    for pilot, got in ((run, "a run"), (run.studies[0], "a study")):
        with refused(tacevo.RunError, got=got, expected="sweep"):
            tacevo.plan("sweep", pilot, effect=0.2)


@pytest.mark.room("publishing")
@pytest.mark.slow
def test_sweep_is_published_from_its_directory(swept: Path, tmp_path: Path) -> None:
    """By the open sweep; a published one is refused."""
    sweep = tacevo.open(swept / "sweep")
    assert isinstance(sweep, tacevo.Sweep)
    tacevo.publish(sweep, tmp_path / "again.zip", authors="Ann Nyone", quiet=True)
    assert b"Ann Nyone" in zipfile.ZipFile(tmp_path / "again.zip").read("ro-crate-metadata.json")
    again = tacevo.open(tmp_path / "again.zip")
    assert isinstance(again, tacevo.Sweep)
    assert_frame_equal(again.jobs, sweep.jobs)
    with refused(tacevo.ConfigError, got="a published sweep", remedy="tacevo extend"):
        tacevo.publish(again, tmp_path / "third.zip")


def test_contrasts_take_the_names_of_terms_and_tables() -> None:
    """Without one, they are of what the sweep states that it is compared by first."""
    arms = {metric: pd.DataFrame() for metric in (Metric.test_accuracy, Metric.qd_score)}
    jobs = pd.DataFrame()
    stated = Ablation(
        reference="none", requested_reference="none", primary=Metric.test_accuracy, jobs=jobs, twins=(), arms=arms
    )
    assert {metric_of(name, stated) for name in (None, "test_score", "test_accuracy", "test accuracy")} == {
        Metric.test_accuracy
    }
    assert metric_of("QD-score", stated) is metric_of("qd_score", stated) is Metric.qd_score
    with refused(tacevo.ConfigError, got="none", expected="one of test_accuracy, qd_score"):
        metric_of(None, replace(stated, primary=None))


def test_notebooks_see_tables(opened: tacevo.Run, swept: Path) -> None:
    """A run, a study, a table and a sweep show themselves as HTML, and texts of the run are text."""
    sweep = tacevo.open(swept / "sweep.zip")
    for shown in (opened, opened.studies[0], opened.tables["gate"], sweep):
        text = shown._repr_html_()
        assert "<table" in text
        assert "<script" not in text


@pytest.mark.room("noise")
def test_verdicts_without_rows_give_their_reason(place: Path) -> None:
    """Too few seeds, a noise run; what is made of such a frame is a frame as any other, and its columns are there."""
    assert main(["search", *SMALLEST, UNTRACKED, *PUBLISHED_SIZES, "run.dir=run"]) == 0
    few = tacevo.study("run", elites=1, seeds=2, epochs=1, quiet=True)
    noise = tacevo.noise("run", elites=1, seeds=2, quiet=True)
    for study, reason in ((few, "at least 4 training seeds"), (noise, "a noise run")):
        known = study.verdicts
        assert (len(known), [*known.columns]) == (0, [*frames.VERDICTS][1:])
        assert reason in repr(known)
        assert reason in known._repr_html_()
        assert reason in known.attrs["left_out"][0]
        assert known.reset_index().shape == (0, len(frames.VERDICTS))
    assert "at least 4 training seeds" in few._repr_html_()


def test_study_that_is_refused_is_named_where_its_absence_shows(run: Path, published: Path) -> None:
    """An empty tuple alone would say that there is none; what is whole is a tuple as any other."""
    whole = tacevo.open(published / "run", store=published / "cache")
    assert isinstance(whole, tacevo.Run)
    assert repr(whole.studies) == repr(tuple(whole.studies))
    assert "left out" not in repr(whole)
    (scores,) = run.glob("studies/*/scores.jsonl")
    scores.write_text("".join(scores.read_text().splitlines(keepends=True)[:-1]))
    opened = tacevo.open(run, store=published / "cache")
    assert isinstance(opened, tacevo.Run)
    assert opened.studies == ()
    (reason,) = opened.left_out
    for said in (repr(opened.studies), repr(opened)):
        assert reason in said
        assert scores.parent.name in said
