"""Promise: a noise run gives fitnesses under other seeds, as the search would, and elites can be chosen by them."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from commands import publish
from refusals import refused
from run_files import copy_that_stands_here
from smallest import Once

from analysis.report.collection import collect, tables_of
from analysis.rounding import shown
from analysis.studies.noise import SeedNoise
from analysis.studies.reestimates import load_reestimates
from analysis.tables.noise import noise_tables
from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.records import Mode, Reason, Rejection, Stage, Training, to_json
from tacevo.results.run import read_run
from tacevo.results.study import load_study
from tacevo.results.study_directory import StudyDirectory, studies_of
from tacevo.results.study_lines import FailedLine, ScoreLine
from tacevo.rules import CURRENT
from tacevo.runs.datasets import load_same, source_of
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import Workbench
from tacevo.storage.store import Store

pytestmark = pytest.mark.timeout(300)

NOISE = ["noise", "run", "elites=2", "seeds=2"]
CHOSEN = ["study", "run=run", "elites=1", "seeds=1", "epochs=2", "choose=reestimated"]


@pytest.fixture(scope="session")
def noisy(published: Path, once: Once) -> Path:
    """Return a directory with a run, its study and its noise run; no test may change it."""

    def fill(folder: Path) -> None:
        copy_that_stands_here(published, folder)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert main(NOISE) == 0

    return once("noisy", fill)


@pytest.fixture
def folder(noisy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a copy of them."""
    shutil.copytree(noisy, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def noise_of(folder: Path) -> StudyDirectory:
    """Return the noise run of a directory."""
    (directory,) = (one for one in studies_of(folder / "run") if one.path.name.startswith("noise"))
    return directory


def rows_of(directory: StudyDirectory) -> list[ScoreLine]:
    """Return the scores of a study or a noise run whose trainings did not fail."""
    return [row for row in directory.read_scores().rows if isinstance(row, ScoreLine)]


def test_noise_run_is_the_searchs_training_under_other_seeds(noisy: Path) -> None:
    """Its evaluations differ from those of the search in the seed alone, and no test score is taken."""
    run, directory = read_run(noisy / "run"), noise_of(noisy)
    header, rows = directory.read_scores().header, rows_of(directory)
    assert (header.terms, header.seeds, header.recipe.epochs) == (None, 2, run.config.training.epochs)
    assert all((row.metrics, row.confusion, row.epoch) == ({}, None, header.recipe.epochs) for row in rows)
    asked: dict[str, Any] = {
        entry.key: (entry.request, entry.answer) for entry in Store(noisy / "cache", "evaluations").entries()
    }
    again = {row.evaluation for row in rows}
    searched = next(request for key, (request, _) in asked.items() if key not in again)
    seeds: set[int] = set()
    for row in rows:
        request, answer = asked[row.evaluation]
        seeds.add(request["seed"])
        assert {**request, "source": "", "seed": 0} == {**searched, "source": "", "seed": 0}
        assert answer["training"]["validation_losses"][-1] == row.validation_loss
    assert len(seeds) == 2
    assert searched["seed"] not in seeds
    studied: list[Any] = list(Store(noisy / "cache", "studies").entries())
    assert not seeds & {entry.request["seed"] for entry in studied}


def test_every_elite_is_trained_again_unless_fewer_are_asked_for(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All is the default; each seed is new, and what is recorded already is not trained again."""
    assert main(["noise", "run", "seeds=1"]) == 0
    sources = {line.source for line in read_run(folder / "run").best(99)}
    (every,) = (one for one in studies_of(folder / "run") if one.read().seeds == 1)
    assert len(every.read().networks) == 1 + len(sources)
    assert "fewer elites" not in capsys.readouterr().err
    before = sorted(folder.glob("cache/*/*/*"))
    assert main(NOISE) == 0
    assert "(6 of 6 trainings recorded already)" in capsys.readouterr().err
    assert sorted(folder.glob("cache/*/*/*")) == before


def test_replay_compares_every_re_estimate(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the store, as it does those of a study; an edited one is found."""
    name = noise_of(folder).path.name
    assert main(["replay", "run"]) == 0
    assert f"study {name}: every score is as recorded" in capsys.readouterr().out
    scores = noise_of(folder).scores
    loss = str(rows_of(noise_of(folder))[0].validation_loss)
    scores.write_text(scores.read_text().replace(loss, "0.123", 1))
    assert main(["replay", "run"]) != 0


@pytest.mark.slow
def test_bundle_holds_the_noise_run_and_can_be_verified(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With its tables, which follow from the records byte for byte, and every entry that they need."""
    publish("run", "-o", "run.zip", "--author", "A. Nyone")
    assert main(["replay", "run.zip"]) == 0
    told = capsys.readouterr().out
    assert noise_of(folder).path.name in told
    assert "EQUAL: search, 2 studies, " in told.splitlines()[-2]


def test_tables_set_record_and_re_estimates_beside_each_other(noisy: Path) -> None:
    """Of the noise run and of the study, whose losses at the search's epoch are fitnesses too."""
    collection = collect(noisy / "run", noisy / "cache")
    assert collection.left_out == ()
    by_name = {one.name: one for one in collection.reestimates}
    assert sorted(name[:5] for name in by_name) == ["elite", "noise"]
    noise, rows = by_name[noise_of(noisy).path.name], rows_of(noise_of(noisy))
    best = collection.run.ranked()[0]
    assert best.fitness in list(SeedNoise(noise).frame.recorded)
    assert noise.median_of(best.id) == pytest.approx(median(row.validation_loss for row in rows if row.id == best.id))
    (study,) = (one for name, one in by_name.items() if name.startswith("elites"))
    tested = rows_of(StudyDirectory(noisy / "run" / "studies" / study.name))
    for network in study.networks:  # of one epoch, which is the search's and the best
        losses = [row.validation_loss for row in tested if row.id == network.id]
        assert study.median_of(network.id) == pytest.approx(median(losses))
    assert study.curves is not None
    assert study.curves.losses.shape[2] == 1
    assert noise.curves is None


def test_archive_whose_elites_were_all_trained_again_is_corrected(folder: Path) -> None:
    """Not by a part of them; the table stands with those of the noise run."""

    def names() -> list[str]:
        collection = collect(folder / "run", folder / "cache")
        return [table.name for table in tables_of(collection, None) if table.name.endswith("/corrected")]

    whole = len({line.source for line in read_run(folder / "run").best(99)}) <= 2
    assert bool(names()) == whole
    assert main(["noise", "run", "seeds=1"]) == 0
    (every,) = (one for one in studies_of(folder / "run") if one.read().seeds == 1)
    assert f"{every.path.name}/corrected" in names()


def failing(directory: StudyDirectory, network: str) -> None:
    """Let the first training of a network have failed."""
    scores = directory.read_scores()
    place = next(place for place, row in enumerate(scores.rows) if row.network == network)
    named: Any = {name: getattr(scores.rows[place], name) for name in ("network", "id", "seed", "evaluation")}
    failed = FailedLine(**named, stage=Stage.train, reason=Reason.not_finite)
    directory.scores.unlink()
    directory.finish(scores.header, [*scores.rows[:place], failed, *scores.rows[place + 1 :]])


def test_network_that_a_seed_does_not_train_is_left_out_by_name(folder: Path) -> None:
    """The others keep their re-estimates; without the baseline there is nothing to compare them with."""
    run, directory = read_run(folder / "run"), noise_of(folder)
    failing(directory, "variant 1")
    reestimates = load_reestimates(directory.read_finished(), run.config, run.facts.fingerprint, folder / "cache")
    assert reestimates is not None
    assert [network.name for network in reestimates.networks] == ["baseline", "variant 2"]
    assert [network.name for network in reestimates.failed] == ["variant 1"]
    assert [len(values) for values in reestimates.estimates] == [2, 2]
    assert any("variant 1" in note for note in noise_tables(reestimates, "force", None)[0].notes)
    failing(directory, "baseline")
    with refused(RunError, expected="a baseline that trains with every seed"):
        load_reestimates(directory.read_finished(), run.config, run.facts.fingerprint, folder / "cache")


def test_noise_run_without_a_training_gives_no_re_estimates(folder: Path) -> None:
    """A median over fewer seeds than it states would be another one."""
    run, directory = read_run(folder / "run"), noise_of(folder)
    scores = directory.read_scores()
    directory.scores.unlink()
    directory.finish(scores.header, scores.rows[:-1])
    with refused(RunError, place=str(directory.path), expected="one score for each network and seed", got="5 others"):
        load_reestimates(directory.read_finished(), run.config, run.facts.fingerprint, folder / "cache")


def test_training_that_the_store_rejects_is_named(folder: Path) -> None:
    """The scores of a study say that it was tested; a store that says otherwise was edited."""
    run = read_run(folder / "run")
    (study,) = (one for one in studies_of(folder / "run") if one.path.name.startswith("elites"))
    key = rows_of(study)[0].evaluation
    store = Store(folder / "cache", "studies")
    (entry,) = (one for one in store.entries() if one.key == key)
    rejection = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="nan")
    (folder / "cache" / "studies" / key[:2] / f"{key}.json").unlink()
    store.write(entry.request, {"rejection": to_json(rejection)})
    with refused(RunError, place=key, expected="a training, as the study's scores say", got="a rejection"):
        load_reestimates(study.read_finished(), run.config, run.facts.fingerprint, folder / "cache")


def test_noise_run_is_not_a_study_with_test_scores(noisy: Path) -> None:
    """It is refused where test scores are wanted."""
    with refused(RunError, got="a noise run", expected="test scores"):
        load_study(noise_of(noisy).path)


def chosen(folder: Path) -> Sequence[str]:
    """Return the ids of the networks of the study whose elites a noise run chose."""
    (record,) = (one.read() for one in studies_of(folder / "run") if one.read().chosen_by)
    return [network.id for network in record.networks]


@pytest.mark.room("page")
def test_noise_run_ends_with_what_it_found_and_the_next_step(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each record beside its re-estimates; `tacevo show` repeats it, and never a re-estimate that is not recorded."""
    assert main(NOISE) == 0
    told = capsys.readouterr().out
    run, directory = read_run(folder / "run"), noise_of(folder)
    again = load_reestimates(directory.read_finished(), run.config, run.facts.fingerprint, folder / "cache")
    assert again is not None
    for row in SeedNoise(again).frame.itertuples():
        cells = [shown(value) for value in (row.recorded, row.median, row.least, row.most)]
        assert all(cell in line for cell in cells for line in told.splitlines() if line.startswith(f"| {row.network} "))
    assert "fitness, one draw" in told
    assert run.shortfall  # one epoch teaches nothing, so no study of it is proposed
    *_, first, second, cited, digest = told.splitlines()
    assert cited.startswith(f"run digest: {run.digest} (the one to cite")
    assert [line.split("tacevo ")[1] for line in (first, second)] == ["tables run", "report run"]
    assert digest == f"digest: {directory.read().digest}"
    assert main(["show", "run"]) == 0
    table = told[told.index("None of the search's 2 best networks") : told.index("look: ")].strip()
    assert table in capsys.readouterr().out
    shutil.rmtree(directory.path)
    assert main(["show", "run"]) == 0
    assert table not in capsys.readouterr().out


@pytest.mark.slow
def test_further_noise_run_that_chooses_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same command is another study then, which says by which noise run its elites were chosen."""
    assert main(CHOSEN) == 0
    assert f"elites chosen by the noise run {noise_of(folder).path.name}\n" in capsys.readouterr().err
    assert main(["noise", "run", "elites=2", "seeds=3"]) == 0
    (further,) = (one for one in studies_of(folder / "run") if one.read().terms is None and one.read().seeds == 3)
    capsys.readouterr()
    assert main(CHOSEN) == 0
    told = capsys.readouterr()
    assert f"elites chosen by the noise run {further.path.name}, the largest of 2\n" in told.err
    assert f"digest {str(further.read().digest)[:12]}" in told.out


@pytest.mark.slow
def test_elites_can_be_chosen_by_their_re_estimates(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By the lowest median of the noise run, whose digest the study keeps; a replay chooses by it again."""
    rows = rows_of(noise_of(folder))
    medians = {row.id: median(one.validation_loss for one in rows if one.id == row.id) for row in rows}
    run = read_run(folder / "run")
    best = min((line.id for line in run.best(99) if line.id in medians), key=medians.__getitem__)
    assert main(CHOSEN) == 0
    assert chosen(folder) == [run.baseline.id, best]
    assert main(["replay", "run"]) == 0
    shutil.rmtree(noise_of(folder).path)
    capsys.readouterr()
    assert main(["replay", "run"]) != 0
    assert "that the elites of a study were chosen by; got studies of the digests " in capsys.readouterr().err


@pytest.mark.slow
def test_loss_of_a_study_at_the_searchs_epoch_is_a_fitness(folder: Path) -> None:
    """Bit for bit what the search's training gives under that seed: more epochs and test images change nothing."""
    assert main(["study", "run=run", "elites=1", "seeds=1", "epochs=2"]) == 0
    run = read_run(folder / "run")
    task, facts = run.record.task, run.record.data
    studied: list[Any] = list(Store(folder / "cache", "studies").entries())
    full = next(entry for entry in studied if entry.request["recipe"]["epochs"] == 2)
    data = load_same(run.config, facts, Progress(), catalogue=source_of(run.config).catalogue())
    with Workbench(run.config, task, facts, Mode.live, data=data) as bench:
        short = bench.evaluator(CURRENT).evaluate(full.request["source"], full.request["seed"])
    assert isinstance(short, Training)
    assert run.config.training.epochs == 1
    assert short.validation_losses[-1] == full.answer["full"]["training"]["validation_losses"][0]


@pytest.mark.parametrize("command", [["noise", "sweep"], ["study", "sweep"], ["study", "run=sweep"]])
def test_sweep_is_not_a_run(command: list[str], sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The error says what to name, and nothing is written."""
    before = {path for path in sweep.rglob("*")}
    assert main(command) == 2
    assert (
        "run: expected the directory of one run; got the sweep sweep; name the run of a job" in capsys.readouterr().err
    )
    assert {path for path in sweep.rglob("*")} == before


def test_study_that_trains_otherwise_gives_no_re_estimates(noisy: Path) -> None:
    """Where the search trained for longer, with other batches, or on other data."""
    run = read_run(noisy / "run")
    training, fingerprint = run.config.training, run.facts.fingerprint
    (study,) = (one for one in studies_of(noisy / "run") if one.path.name.startswith("elites"))
    assert load_reestimates(study.read_finished(), run.config, fingerprint, noisy / "cache") is not None
    for changed in (replace(training, epochs=2), replace(training, batch_size=7)):
        config = replace(run.config, training=changed)
        assert load_reestimates(study.read_finished(), config, fingerprint, noisy / "cache") is None
    assert load_reestimates(study.read_finished(), run.config, "other", noisy / "cache") is None


def test_training_that_the_store_lacks_is_named(folder: Path) -> None:
    """The study stays whole, which is not a failed check; why it has no re-estimates is said."""
    shutil.rmtree(folder / "cache" / "studies")
    collection = collect(folder / "run", folder / "cache")
    assert (len(collection.studies), len(collection.reestimates)) == (1, 1)
    assert collection.left_out == ()
    assert "none of baseline with seed 0" in collection.remarks[0]
