"""Promise: the test score of a job is that of the network that it found, from the study that its sweep stated."""

import json
from dataclasses import fields, replace
from pathlib import Path
from statistics import median

import pytest
from ledger_lines import score as line
from ledger_lines import study_header
from refusals import refused
from studies import study_of

from tacevo.choices import ChosenBy
from tacevo.errors import RunError
from tacevo.records import Reason, Stage
from tacevo.results.job_scores import FailedTestError, JobScore, _score, job_score
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study import RecordedStudy
from tacevo.results.study_directory import StudyDirectory, is_stated
from tacevo.results.study_lines import Design, FailedLine
from tacevo.storage.sweep_directory import Retraining

#: What the study of the `published` run is.
STATED = Retraining(seeds=4, epochs=1, choose=ChosenBy.fitness)

MEASURED = study_of({"baseline": [0.1, 0.2, 0.6], "variant 1": [0.3, 0.5, 0.4], "variant 2": [0.0, 0.0, 0.0]})


def studied(*fitnesses: float) -> RecordedStudy:
    """Return the study of three networks with these fitnesses; the third, the second best elite, tests best."""
    networks = (
        replace(one, id=f"g0{at}s00", fitness=fitness)
        for at, (one, fitness) in enumerate(zip(MEASURED.networks, fitnesses, strict=True))
    )
    return replace(MEASURED, networks=tuple(networks))


def with_third(study: RecordedStudy, fitness: float = 0.45) -> RecordedStudy:
    """Let the third network be a candidate of the run `run`, too."""
    return replace(study, networks=(*study.networks[:2], replace(study.networks[2], id="g01s01", fitness=fitness)))


def scored(run: RecordedRun, study: RecordedStudy) -> JobScore:
    """Score a study by its own rows."""
    return _score(run, study, study.scores, 1)


def test_score_is_the_median_of_the_best_by_fitness(run: Path) -> None:
    """By hand: 0.4 of the elite; the baseline's 0.2 where it is fitter or as fit; test scores choose nothing."""
    recorded = read_run(run)
    assert scored(recorded, studied(0.5, 0.4, 0.45)).values == ((0.3, 0.5, 0.4),)
    assert scored(recorded, studied(0.5, 0.4, 0.45)).value == 0.4
    assert scored(recorded, studied(0.3, 0.4, 0.45)).value == 0.2
    assert scored(recorded, studied(0.4, 0.4, 0.45)).networks == ("g00s00",)


def test_several_networks_give_one_value(run: Path) -> None:
    """By hand: the two fittest of three, baseline or not; the mean of their medians, the geometric mean of all losses.

    One perfect training makes that mean 0, and no logarithm fails.
    """
    recorded, study = read_run(run), studied(0.41, 0.4, 0.45)
    two = _score(recorded, study, study.scores, 2)
    assert two.networks == ("g01s00", "g00s00")
    assert two.value == pytest.approx((0.4 + 0.2) / 2, rel=1e-8)
    assert two.losses == two.values == ((0.3, 0.5, 0.4), (0.1, 0.2, 0.6))
    assert two.loss == pytest.approx((0.3 * 0.5 * 0.4 * 0.1 * 0.2 * 0.6) ** (1 / 6), rel=1e-8)
    three = with_third(study, fitness=0.405)
    assert _score(recorded, three, study.scores, 2).networks == ("g01s00", "g01s01")
    assert _score(recorded, three, study.scores, 2).loss == 0


@pytest.mark.parametrize(("count", "lacking"), [(2, 0), (3, 1), (5, 3)])
def test_every_job_has_a_value_of_as_many_networks(count: int, lacking: int, run: Path) -> None:
    """By hand: the baseline, which ranks second of three, has each place that no other takes."""
    recorded, study = read_run(run), with_third(studied(0.41, 0.4, 0.45))
    score = _score(recorded, study, study.scores, count)
    medians = {"g01s00": 0.4, "g00s00": 0.2, "g01s01": 0.0}
    wanted = [*medians][:count] + ["g00s00"] * (count - 3)
    assert (list(score.networks), score.lacking) == (wanted, lacking)
    assert score.value == pytest.approx(sum(medians[name] for name in wanted) / count, rel=1e-8)
    assert len(score.losses) == len(score.values) == count


def test_study_of_fewer_networks_than_stated_is_not_the_test(run: Path) -> None:
    """The archive has more of them; a study of all that it has is, however many were wished for."""
    recorded = read_run(run)
    most = len(recorded.best(99))
    (directory,) = (StudyDirectory(path) for path in run.glob("studies/*"))
    studied_ones = len(directory.read().networks) - 1
    assert most > studied_ones >= 1  # else this test attacks nothing
    assert len(job_score(recorded, replace(STATED, elites=studied_ones)).networks) == studied_ones
    with refused(RunError, expected="one finished study with the settings that the sweep states"):
        job_score(recorded, replace(STATED, elites=studied_ones + 1))
    kept = [elite for elite in recorded.elites if elite.id in {one.id for one in directory.read().networks}]
    assert job_score(replace(recorded, elites=tuple(kept)), replace(STATED, elites=99)).value > 0


def test_score_is_of_the_network_that_a_noise_run_chose(run: Path) -> None:
    """The lowest median of its re-estimates, whatever was recorded; without that noise run nothing is known."""
    study = studied(0.3, 0.4, 0.45)
    noise = study_header(run=study.run, terms=None, networks=study.networks[:2], seeds=3)
    losses = {"baseline": (0.5, 0.6, 0.1), "variant 1": (0.4, 0.4, 0.9)}
    rows = [
        replace(line(one.name, seed, 0.0), id=one.id, validation_loss=loss, metrics={})
        for one in noise.networks
        for seed, loss in enumerate(losses[one.name])
    ]
    directory = StudyDirectory(run / "studies" / "noise")
    directory.begin(noise, scale=(), units=(), versions={}, machine={})
    chosen = replace(study, chosen_by=directory.finish(noise, rows))
    assert scored(read_run(run), study).networks == ("g00s00",)
    assert scored(read_run(run), chosen).networks == ("g01s00",)
    with refused(RunError, expected="the noise run"):
        scored(read_run(run), replace(chosen, chosen_by="f" * 64))


def test_score_is_read_from_the_runs_own_study(run: Path) -> None:
    """As its lines have it."""
    score = job_score(read_run(run), STATED)
    (lines,) = run.glob("studies/*/scores.jsonl")
    rows = [json.loads(line) for line in lines.read_text().splitlines()[1:]]
    scores = [row["metrics"]["mse"] for row in rows if row["id"] == score.networks[0]]
    assert len(scores) == 4
    assert score.value == pytest.approx(median(scores), rel=1e-8)


@pytest.mark.parametrize(
    "stated",
    [replace(STATED, seeds=5), replace(STATED, epochs=2), replace(STATED, choose=ChosenBy.reestimated)],
)
def test_other_study_does_not_count(stated: Retraining, run: Path) -> None:
    """A study that happens to be there was not stated beforehand."""
    with refused(
        RunError, place="run/studies", expected="one finished study with the settings that the sweep states", got="none"
    ):
        job_score(read_run(run), stated)


def test_study_that_was_edited_or_is_not_finished_does_not_count(run: Path) -> None:
    """Nothing of it is believed."""
    (scores,) = run.glob("studies/*/scores.jsonl")
    whole = scores.read_text()
    scores.write_text(whole.replace('"mse":0.', '"mse":1.', 1))
    with refused(RunError, place="scores.jsonl"):
        job_score(read_run(run), STATED)
    scores.write_text(whole)
    described = scores.parent / "study.json"
    described.write_text(json.dumps({**json.loads(described.read_text()), "digest": None}))
    with refused(RunError, expected="one finished study", got="none"):
        job_score(read_run(run), STATED)


def test_noise_run_and_study_on_other_data_are_not_the_test() -> None:
    """The first has seeds and epochs, and sees no test image; the second sees those of another sensor or split."""
    stated = Retraining(seeds=MEASURED.seeds, epochs=MEASURED.recipe.epochs, choose=ChosenBy.fitness)
    assert is_stated(MEASURED, stated)
    values = {field.name: getattr(MEASURED, field.name) for field in fields(Design)}
    assert not is_stated(Design(**{**values, "terms": None}), stated)
    assert not is_stated(Design(**{**values, "other_data": (("split_seed", 7),)}), stated)


def test_failure_counts_only_of_the_network_that_was_found(run: Path) -> None:
    """A baseline that fails its test leaves the score of the elite; an elite that fails is said to have failed."""
    recorded, study = read_run(run), studied(0.5, 0.4, 0.45)

    def with_failure(name: str) -> JobScore:
        one = FailedLine(network=name, id="x", seed=1, evaluation="e", stage=Stage.train, reason=Reason.out_of_time)
        kept = [row for row in study.scores if (row.network, row.seed) != (name, 1)]
        return _score(recorded, study, [*kept, one], 1)

    assert with_failure("baseline").values == ((0.3, 0.5, 0.4),)
    with refused(FailedTestError, place="variant 1 (g01s00)", got="out_of_time with seed 1"):
        with_failure("variant 1")


def test_score_needs_every_seed(run: Path) -> None:
    """A median over fewer would be another one."""
    study = studied(0.5, 0.4, 0.45)
    rows = [row for row in study.scores if row.network == "variant 1"]
    with refused(RunError, place="variant 1", expected="3 scores"):
        _score(read_run(run), study, rows[:2], 1)
