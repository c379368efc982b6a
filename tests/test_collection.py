"""Promise: a run gives all its tables and pictures, and says which of its studies are left out and why."""

from dataclasses import replace

import numpy as np
import pytest
from hand_runs import closed, run, trained
from studies import study_of

from analysis.collection import Collection, Compared, pictures_of, tables_of
from analysis.comparison import compare
from analysis.loading import Elite, Run
from analysis.tessellation import Niches
from tacevo.records import Kind

NICHES = Niches(networks=np.array([[0.3, 0.5], [0.7, 0.5]]), prompts=np.array([[0.5, 0.5]]))
SCORES = {"baseline": [0.9, 0.91, 0.92, 0.93], "variant 1": [0.95, 0.96, 0.97, 0.98]}


def searched() -> Run:
    """Give a run with two elites, one a child of the other."""
    elites = [
        Elite(id="g00s00", niche=0, fitness=0.5, descriptors=(0.3, 0.5)),
        Elite(id="g01s00", niche=1, fitness=0.4, descriptors=(0.7, 0.5)),
    ]
    slots = [trained(0, 0, 0.5), trained(1, 0, 0.4), trained(1, 1, 0.9)]
    return run(slots, [closed(0, 0.5), closed(1, 0.4, candidates=2, trained=2)], elites=elites)


def collection(*kinds: Kind, searched: Run) -> Collection:
    """Give a run with a study of each kind."""
    studies = [study_of(SCORES, kind=kind) for kind in kinds]
    compared = [
        Compared(name=f"study{number}", study=study, comparisons=compare(study))
        for number, study in enumerate(studies, start=1)
    ]
    return Collection(run=searched, niches=NICHES, studies=tuple(compared), refused=())


def names(found: Collection) -> list[str]:
    """List the names of all pictures and tables."""
    return [picture.name for picture in pictures_of(found)] + [table.name for table in tables_of(found, None)]


def test_run_has_every_picture() -> None:
    """Those of the search first, those of the study last."""
    found = pictures_of(collection(Kind.classification, searched=searched()))
    assert [picture.name for picture in found] == [
        "fitness_evolution", "trainable", "archive_growth", "temperature", "network_map", "prompt_map",
        "prompt_productivity", "lineage", "training_curves", "seed_boxes", "confusion_matrices"
    ]  # fmt: skip
    assert all(picture.caption.endswith(".") for picture in found)


def test_regression_has_no_confusion() -> None:
    """Its figure of seeds stands alone."""
    assert "confusion_matrices" not in names(collection(Kind.regression, searched=searched()))


def test_what_a_run_never_had_is_not_drawn() -> None:
    """No prompt archive, no instruction, no trained network: no figure of it."""
    bare = replace(searched(), elites=(), instructions=(), candidates=())
    bare = replace(bare, config={**bare.config, "prompts": {"policy": "none"}})
    found = [picture.name for picture in pictures_of(collection(searched=bare))]
    assert found == ["fitness_evolution", "trainable", "archive_growth", "temperature", "network_map"]


def test_files_of_several_studies_do_not_overwrite_each_other() -> None:
    """Each name ends in its study's, and none comes twice."""
    found = names(collection(Kind.regression, Kind.regression, searched=searched()))
    assert {"seed_boxes_study1", "seed_boxes_study2"} <= set(found)
    assert len(found) == len(set(found))


def test_words_above_the_boxes_are_those_of_the_comparison() -> None:
    """The verdict and Holm's p stand above each variant."""
    found = collection(Kind.regression, searched=searched())
    (boxes,) = (picture for picture in pictures_of(found) if picture.name == "seed_boxes")
    (axes,) = boxes.draw().axes
    assert [text.get_text() for text in axes.texts] == ["", "worse\np = 0.029"]


def test_lineage_leads_from_the_baseline_to_the_best() -> None:
    """Nobody else is in it."""
    (drawn,) = (one for one in pictures_of(collection(searched=searched())) if one.name == "lineage")
    (axes,) = drawn.draw().axes
    assert [text.get_text() for text in axes.texts if text.get_text().startswith("g")] == ["g00s00", "g01s00"]


def test_curves_show_the_baseline_once() -> None:
    """Also where it is an elite itself."""
    (drawn,) = (one for one in pictures_of(collection(searched=searched())) if one.name == "training_curves")
    (axes,) = drawn.draw().axes
    assert [line.get_label() for line in axes.lines] == ["baseline", "g01s00"]


@pytest.mark.parametrize("kind", list(Kind))
def test_every_picture_can_be_drawn(kind: Kind) -> None:
    """Of the smallest run and study that there can be."""
    found = collection(kind, searched=searched())
    assert all(picture.draw().axes for picture in pictures_of(found))


def test_study_without_a_comparison_keeps_its_scores_and_boxes() -> None:
    """Too few seeds to compare are enough to be shown; the caption speaks of no p."""
    found = collection(Kind.regression, searched=searched())
    alone = replace(found, studies=tuple(replace(compared, comparisons=None) for compared in found.studies))
    assert {"scores_force", "metrics_force"} <= set(names(alone))
    assert not {"verdicts_force", "effects_force"} & set(names(alone))
    (boxes,) = (picture for picture in pictures_of(alone) if picture.name == "seed_boxes")
    assert boxes.caption.endswith("the baseline's median.")
    assert boxes.draw().axes
