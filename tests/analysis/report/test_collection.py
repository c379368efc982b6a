"""Promise: a run gives all its tables and pictures, and says which of its studies are left out and why."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_runs import altered, closed, configured, elite, rejected, run, trained
from ledger_lines import score, study_header
from studies import study_of

from analysis.report.collection import Collection, Compared, read_studies, tables_of, with_largest_studies
from analysis.report.figure_list import pictures_of, undrawn, variants_of
from analysis.runs.niches import Niches
from analysis.studies.comparison import compare
from tacevo.records import Kind, Reason, Stage
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study_directory import StudyDirectory, studies_of

pytestmark = pytest.mark.room("figures")

NICHES = Niches(networks=np.array([[0.3, 0.5], [0.7, 0.5]]), prompts=np.array([[0.5, 0.5]]))
SCORES = {"baseline": [0.9, 0.91, 0.92, 0.93], "variant 1": [0.95, 0.96, 0.97, 0.98]}


def searched() -> RecordedRun:
    """Return a run with two elites, one a child of the other."""
    elites = [
        elite("g00s00", niche=0, fitness=0.5),
        elite("g01s00", niche=1, fitness=0.4),
    ]
    slots = [trained(0, 0, 0.5), trained(1, 0, 0.4), trained(1, 1, 0.9)]
    return run(slots, [closed(0, 0.5), closed(1, 0.4, candidates=2, trained=2)], elites=elites)


def collection(*kinds: Kind, searched: RecordedRun) -> Collection:
    """Return a run with a study of each kind."""
    studies = [study_of(SCORES, kind=kind) for kind in kinds]
    compared = [
        Compared(name=f"study{number}", study=study, comparisons=compare(study))
        for number, study in enumerate(studies, start=1)
    ]
    return Collection(run=searched, niches=NICHES, studies=tuple(compared), reestimates=(), left_out=())


def names(collection: Collection) -> list[str]:
    """List the names of all pictures and tables."""
    return [picture.name for picture in pictures_of(collection)] + [table.name for table in tables_of(collection, None)]


@pytest.mark.room("Pareto")
def test_run_has_every_picture() -> None:
    """Those of the search first, those of the study last."""
    pictures = pictures_of(collection(Kind.classification, searched=searched()))
    assert [picture.name for picture in pictures] == [
        "fitness", "archive_growth", "temperature", "network_map",
        "prompt_map", "prompt_productivity", "lineage", "training_curves", "pareto",
        "study1/seed_boxes", "study1/forest", "study1/confusion_matrices"
    ]  # fmt: skip
    assert all(picture.caption.endswith(".") for picture in pictures)


def test_bars_that_are_all_whole_are_a_sentence() -> None:
    """A run of which nothing was rejected has no picture of rejections, and says why; one with a rejection has it."""
    whole = searched()
    (said,) = undrawn(whole)
    assert said.startswith("no trainable: all 2 first answers")
    broken = altered(whole, candidates=(*whole.candidates, rejected(1, 2, Stage.policy, Reason.forbidden_import)))
    assert undrawn(broken) == ()
    assert "trainable" in names(collection(searched=broken))


def test_candidate_has_one_name_in_a_run_and_its_study() -> None:
    """Its id, with the number of the study behind it where every study calls it alike."""
    gathered = collection(Kind.regression, searched=searched())
    (one,) = gathered.studies
    baseline, variant = one.study.networks
    network = replace(variant, id="g01s00")
    one = replace(one, study=replace(one.study, networks=(baseline, network)))
    gathered = replace(gathered, studies=(one,))
    drawn = {picture.name: picture.draw() for picture in pictures_of(gathered) if picture.name != "samples"}
    (boxes,), (forest,) = drawn["study1/seed_boxes"].axes, drawn["study1/forest"].axes
    assert boxes.get_xticklabels()[1].get_text().replace("\n", " ") == network.whole_name
    assert [label.get_text() for label in forest.get_yticklabels()] == [network.whole_name]
    assert variants_of(gathered)[network.id] == network.whole_name == f"{network.id} (variant 1)"
    second = replace(one, study=replace(one.study, networks=(baseline, replace(network, name="variant 2"))))
    assert network.id not in variants_of(replace(gathered, studies=(one, second)))


def test_forest_shows_the_difference_that_was_found() -> None:
    """By hand: medians of 0.965 and 0.915, in points; its interval holds it, and no difference is in sight."""
    scored = [(name, [100 * value for value in values]) for name, values in SCORES.items()]
    expected = float(np.median(scored[1][1]) - np.median(scored[0][1]))
    gathered = collection(Kind.classification, searched=searched())
    (forest,) = (picture for picture in pictures_of(gathered) if picture.name == "study1/forest")
    (axes,) = forest.draw().axes
    across = {line.get_marker(): np.asarray(line.get_xdata(), dtype=float) for line in axes.lines[:2]}
    assert across["o"].tolist() == pytest.approx([expected])
    assert across["None"][0] <= expected <= across["None"][1]
    low, high = axes.get_xlim()
    assert low < 0 < high
    assert any(text.get_text().startswith("better, p = 0.029") for text in axes.texts)


def test_what_a_run_never_had_is_not_drawn() -> None:
    """No prompt archive, no instruction, no trained network: no figure of it."""
    bare = altered(searched(), elites=(), instructions=(), candidates=())
    bare = replace(bare, config=configured(prompts={"policy": "none"}))
    names = [picture.name for picture in pictures_of(collection(searched=bare))]
    assert names == ["fitness", "trainable", "archive_growth", "temperature", "network_map"]


def test_files_of_several_studies_do_not_overwrite_each_other() -> None:
    """Each name begins with its study's, of one study as of two, and none comes twice."""
    assert "study1/seed_boxes" in names(collection(Kind.regression, searched=searched()))
    both = collection(Kind.regression, Kind.regression, searched=searched())
    drawn = [picture.name for picture in pictures_of(both)]
    assert {"study1/seed_boxes", "study2/seed_boxes"} <= set(drawn)
    assert len(drawn) == len(set(drawn))
    tables = [table.name for table in tables_of(both, None)]
    assert len(tables) == len(set(tables))


def test_words_above_the_boxes_are_those_of_the_comparison() -> None:
    """The verdict and Holm's p stand above each variant."""
    gathered = collection(Kind.regression, searched=searched())
    (boxes,) = (picture for picture in pictures_of(gathered) if picture.name == "study1/seed_boxes")
    (axes,) = boxes.draw().axes
    assert [text.get_text() for text in axes.texts] == ["", "worse\np = 0.029", "verdict\np after Holm"]


def test_largest_study_is_the_one_of_a_paper() -> None:
    """Epochs before seeds before networks; what the studies found does not matter."""
    small, large = collection(Kind.regression, Kind.regression, searched=searched()).studies
    longer = replace(small, study=replace(small.study, recipe=replace(small.study.recipe, epochs=90)))
    more = replace(large, study=replace(large.study, seeds=90))
    both = replace(collection(searched=searched()), studies=(longer, more))
    assert with_largest_studies(both).studies == (longer,)
    assert with_largest_studies(replace(both, studies=(small, more))).studies == (more,)
    assert with_largest_studies(replace(both, studies=())).studies == ()


@pytest.mark.parametrize("kind", list(Kind))
def test_every_picture_can_be_drawn(kind: Kind) -> None:
    """Of the smallest run and study that there can be."""
    gathered = collection(kind, searched=searched())
    assert all(picture.draw().axes for picture in pictures_of(gathered))


def test_study_without_a_comparison_keeps_its_scores_and_boxes() -> None:
    """Too few seeds to compare are enough to be shown; the caption speaks of no p."""
    gathered = collection(Kind.regression, searched=searched())
    alone = replace(gathered, studies=tuple(replace(compared, comparisons=None) for compared in gathered.studies))
    kinds = {name.rpartition("/")[2] for name in names(alone)}
    assert {"scores", "metrics"} <= kinds
    assert not {"verdicts", "effects"} & kinds
    (boxes,) = (picture for picture in pictures_of(alone) if picture.name.endswith("/seed_boxes"))
    assert boxes.caption.endswith("the baseline's median.")
    assert boxes.draw().axes


@pytest.mark.slow
def test_study_of_the_run_before_it_was_continued_says_nothing_of_it(folder: Path) -> None:
    """Its elites may not be the best any more: neither scores nor re-estimates are taken from it."""
    (study,) = studies_of(folder / "run")
    described = json.loads((study.path / "study.json").read_text())
    (study.path / "study.json").write_text(json.dumps({**described, "run": "0" * 64}))
    studies = read_studies(read_run(folder / "run"))
    assert (studies.studies, studies.reestimates) == ((), ())
    (told,) = studies.left_out
    assert ", before it was continued; study it again" in told


@pytest.mark.slow
@pytest.mark.parametrize(("networks", "is_told"), [(1, False), (2, True)])
def test_study_that_cannot_be_compared_keeps_its_scores(
    networks: int, is_told: bool, published: Path, place: Path
) -> None:
    """With one seed the reason is told, and nothing failed; a baseline alone was asked for, and lacks nothing."""
    recorded = read_run(published / "run")
    header = study_header(run=recorded.digest, seeds=1, networks=study_header().networks[:networks])
    directory = StudyDirectory(place / "studies" / "small")
    directory.begin(header, scale=(), units=(), versions={}, machine={})
    directory.finish(header, [score(network.name, 0, 0.1) for network in header.networks])
    read = read_studies(altered(recorded, path=place))
    assert [len(one.study.scores) for one in read.studies] == [networks]
    assert read.studies[0].comparisons is None
    assert read.left_out == ()
    assert [reason.startswith("the comparison of ") for reason in read.remarks] == [True] * is_told
