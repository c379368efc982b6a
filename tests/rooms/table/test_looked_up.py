"""Runs whose evaluations were looked up say so, find their table by its digest, and advise nothing that it lacks."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from checkout import ROOT
from made_up import TINY, made_up_table
from refusals import refused

import tacevo
from tacevo.cli.app import main
from tacevo.cli.tabulate import NICE
from tacevo.config.compose import compose
from tacevo.errors import BundleError, ConfigError
from tacevo.results.run import read_run
from tacevo.results.space_table import read_table, write_table
from tacevo.results.summary import summarise
from tacevo.results.table_records import SpaceTable
from tacevo.runs.progress import Progress
from tacevo.runs.session import search
from tacevo.storage.store import Store, read_entry

#: Of the table; a search of two epochs leaves two seeds for noise runs.
SIZES = ("training.epochs=3",)


@pytest.fixture
def table(place: Path) -> SpaceTable:
    """Make up the table of a tiny space, in the working directory."""
    return made_up_table(place / "tables" / "space.zip", *TINY, *SIZES)


def _settings(table: SpaceTable, *more: str) -> list[str]:
    return ["experiment=space", *TINY, "data=table", f"data.root={table.path}", "training.epochs=2", *more]


def _looked_up(table: SpaceTable, *more: str) -> Path:
    """Search a table; return the directory of the run."""
    search(compose(_settings(table, "run.dir=run", *more)), Progress())
    return Path("run")


def _published(place: Path) -> SpaceTable:
    """Search a table of two seeds of the project's, which lies nowhere else, and publish the run as bundles/run.zip."""
    whole = read_table(ROOT / "cache/tables/grating-space.zip")
    trainings = [row for row in whole.trainings if row.seed < 2]
    header = replace(whole.header, seeds=whole.header.seeds[:2])
    table = write_table(place / "tables" / "space.zip", header, whole.networks, trainings)
    sizes = ["search.generations=1", "search.candidates=2", "search.initial=2", "tracking=none", "run.dir=run"]
    search(compose(["experiment=table", f"data.root={table.path}", *sizes]), Progress())
    tacevo.publish("run", "run.zip", quiet=True)
    Path("bundles").mkdir()
    Path("run.zip").rename("bundles/run.zip")
    return table


@pytest.mark.parametrize("fitness", ["last", "lowest", "mean_of_3"])
def test_summary_says_looked_up_and_speaks_of_no_training(table: SpaceTable, fitness: str) -> None:
    """Nothing was trained, by whatever rule a fitness is made; only the data's parts bear that name."""
    more = ["training.epochs=3"] if fitness == "mean_of_3" else []
    run = read_run(_looked_up(table, f"training.fitness={fitness}", "search.training_flops=1e15", *more))
    said = summarise(run)
    assert (run.path / "summary.md").read_text() == said
    assert f"looked up in the table {table.digest[:12]}" in said
    assert "| looked up |" in said
    assert "trained" not in said
    assert "training" not in said.replace("search.training_flops", "").replace("400 training, ", "")


def test_table_is_found_by_its_digest(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Beside the bundle under any name, in cache/tables, or by --table; another table of its name is not taken."""
    table = _published(place)
    elsewhere = table.path.rename("kept")
    made_up_table(Path("bundles/space.zip"), *TINY, "training.epochs=3", seeds=1)
    replay = ["replay", "bundles/run.zip", "--retrain", "2"]
    capsys.readouterr()
    assert main(replay) == 2
    refusal = capsys.readouterr().err
    assert "space.zip" in refusal
    assert table.digest in refusal
    assert "--table" in refusal
    assert "generation" not in refusal  # nothing was run again before
    assert main([*replay, "--table", "bundles/space.zip"]) == 2
    assert main([*replay, "--table", "bundles/run.zip"]) == 1
    for found in ("kept", "bundles/mine.zip", "cache/tables/other.zip"):
        Path(found).parent.mkdir(parents=True, exist_ok=True)
        elsewhere = elsewhere.rename(found)
        capsys.readouterr()
        assert main([*replay, *(["--table", found] if found == "kept" else [])]) == 0
        said = capsys.readouterr().out
        assert f"looked up in {found} again" in said
        assert "retrained" not in said
    # A run in a directory, too, whose table is not where it was any more.
    assert main(["replay", "run", "--retrain", "1"]) == 0
    capsys.readouterr()
    assert main(["noise", "run", "elites=1", "seeds=1"]) == 0
    assert "trained again" not in capsys.readouterr().out


@pytest.mark.slow
def test_published_run_is_extended_by_the_table_that_is_at_hand(place: Path) -> None:
    """The run that goes on names the table that was found."""
    shutil.move(_published(place).path, "bundles/any name.zip")
    more = ("search.generations=2", "tracking=none", "run.dir=longer")
    with refused(BundleError, place="another.zip"):
        tacevo.extend("bundles/run.zip", *more, "data=table", "data.root=another.zip", quiet=True)
    longer = tacevo.extend("bundles/run.zip", *more, quiet=True)
    assert longer.config.data.root == "bundles/any name.zip"


def test_option_of_the_table_is_for_searches_that_looked_up(
    table: SpaceTable, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It means nothing without --retrain, for a run that trained, and for a table itself."""
    run = str(published / "run.zip")
    assert main(["replay", run, "--table", "x.zip"]) == 2
    assert main(["replay", run, "--retrain", "1", "--table", "x.zip"]) == 2
    assert main(["replay", str(table.path), "--retrain", "1", "--table", "x.zip"]) == 2
    assert capsys.readouterr().err.count("error: --table") == 2


def test_noise_run_advises_nothing_that_a_table_has_not(table: SpaceTable, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither more seeds, where two are all, nor fewer elites, where two seeds tell none apart, nor a study."""
    run = str(_looked_up(table))
    assert main(["noise", run, "seeds=2"]) == 0
    said = capsys.readouterr()
    assert "cannot tell any" in said.out
    assert "seeds=" not in said.out
    assert "elites=" not in said.out
    assert "tacevo study" not in said.out + said.err
    with refused(ConfigError, place="seeds", expected="at most 2", remedy="seeds=2"):
        tacevo.noise(run, quiet=True)
    table = made_up_table(Path("tables/one.zip"), *TINY, *SIZES, seeds=1)
    alone = _looked_up(table, "run.dir=alone")
    with refused(ConfigError, place="seeds", expected="at most 0", remedy="a table of more seeds"):
        tacevo.noise(alone.with_name("alone"), seeds=1, quiet=True)


@pytest.mark.few(3)
@pytest.mark.parametrize("llm", ["grammar", "anthropic", "openai"])
def test_answers_that_are_bound_to_no_space_have_one_remedy(table: SpaceTable, llm: str) -> None:
    """Whatever is named beside a table: only the grammar within its space has rows there."""
    settings = ["experiment=table", f"data.root={table.path}", f"llm={llm}", "run.dir=run"]
    settings += ["llm.model=m"] if llm == "openai" else []
    with refused(ConfigError, place="llm", got=llm, remedy="set llm=grammar_space"):
        search(compose(settings), Progress())
    assert not Path("run").exists()


def test_wrong_things_are_told_what_is_wanted(table: SpaceTable, published: Path) -> None:
    """A path, a directory, a bundle, a run, a sweep, a number: each function names what it takes, and the way to it."""
    run_path = _looked_up(table)
    run, opened = tacevo.open(run_path), tacevo.open_table(table.path)
    wanted = "`tacevo tabulate` writes"
    for path, got in ((run_path, "of a run"), (Path(), "a directory"), (published / "run.zip", "the bundle of a run")):
        with refused(BundleError, place=str(path), expected=wanted, got=got):
            tacevo.open_table(path)
    for value in (run, opened, None, 3):
        with refused(ConfigError, place="path", expected=wanted):
            tacevo.open_table(value)  # type: ignore[arg-type]
    for wrong in (str(run_path), run_path, opened, None):
        is_path = isinstance(wrong, str | os.PathLike)
        with refused(ConfigError, place="run", expected="one run", remedy="tacevo.open('run')" if is_path else ""):
            opened.regret(wrong)  # type: ignore[arg-type]
        with refused(ConfigError, place="sweep", expected="a sweep", remedy="tacevo.open('run')" if is_path else ""):
            opened.size_and_power(wrong, seeds=2)  # type: ignore[arg-type]


@pytest.mark.slow
def test_sweep_of_a_table_has_no_test_scores_and_gets_none(table: SpaceTable) -> None:
    """No study is advised; and what is no number of seeds is told how many there are."""
    more = ["ablation=none,drift", "seed=0,1", "search.generations=1", "search.candidates=2"]
    assert main(["search", "-m", *_settings(table, *more), "--into", "sweep"]) == 0
    swept, opened = tacevo.open("sweep"), tacevo.open_table(table.path)
    assert isinstance(swept, tacevo.Sweep)
    for metric in ("test_score", "test_loss", "test_accuracy"):
        with refused(ConfigError, place="metric", remedy="no test images") as caught:
            swept.contrasts(metric)
        assert "study" not in str(caught.value)
    assert len(swept.contrasts()) == 2
    for seeds in (2, 1, 2.5, "2"):
        with refused(ConfigError, place="seeds", expected="4 seeds", got=str(seeds)):
            opened.size_and_power(swept, seeds=seeds)  # type: ignore[arg-type]


def test_table_is_made_at_low_priority(place: Path) -> None:
    """Hours of trainings let other work of the machine go first."""
    pid = os.fork()
    if pid == 0:  # niceness cannot be taken back
        status = main(["tabulate", "experiment=space", "data=folder", "data.root=absent", "-o", "table.zip"])
        os._exit(os.getpriority(os.PRIO_PROCESS, 0) if status == 2 else 100)
    # A test before this one may have lowered the priority of this process.
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == max(NICE, os.getpriority(os.PRIO_PROCESS, 0))


@pytest.mark.slow
def test_twins_that_differ_end_every_command_of_their_sweep_alike(
    table: SpaceTable, capsys: pytest.CaptureFixture[str]
) -> None:
    """Arms that are one search by construction, one of them by a store in which a training is another."""
    sizes = ["seed=0,1", "search.generations=1", "search.candidates=2"]

    def search_arm(arm: str, store: str) -> None:
        more = [*sizes, f"ablation={arm}", f"store.root={store}"]
        assert main(["search", "-m", *_settings(table, *more), "--into", "sweep"]) == 0

    commands = (["ablations"], ["tables"], ["figures"], ["report"])
    search_arm("none", "cache")
    shutil.copytree("cache", "other")
    for path in Path("other/evaluations").glob("*/*.json"):
        entry = read_entry(path)
        altered = json.loads(
            json.dumps(entry.answer).replace('"validation_losses": [', '"validation_losses": [0.001, ')
        )
        altered["training"]["validation_losses"].pop()
        path.unlink()
        Store(Path("other"), "evaluations").write(entry.request, altered)
    search_arm("no_prompt_archive", "other")
    for command in commands:
        capsys.readouterr()
        assert main([*command, "sweep"]) == 1, command
        assert "ERROR" in capsys.readouterr().err, command
