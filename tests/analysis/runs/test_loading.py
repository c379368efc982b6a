"""Promise: a run is read as its ledger has it, or refused; what counts as its best networks is one rule."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hand_runs import closed, elite, trained
from hand_runs import run as made
from ledger_lines import candidate
from refusals import refused

from analysis.runs.niches import load_niches
from tacevo.choices import Scale
from tacevo.errors import RunError
from tacevo.results.run import RecordedRun, descriptors_of, read_run
from tacevo.studies.networks import networks_of


def test_elites_are_those_of_the_ledger(published: Path) -> None:
    """Each with the fitness and the descriptors of its candidate, and as archive.json has it."""
    read = read_run(published / "run")
    recorded = json.loads((published / "run" / "archive.json").read_text())["elites"]
    assert [(elite.id, elite.niche, elite.fitness) for elite in read.elites] == [
        (entry["id"], entry["niche"], entry["fitness"]) for entry in recorded
    ]
    lines = {line.id: line for line in read.candidates}
    descriptors = [list(descriptors_of(lines[elite.id], Scale.log)) for elite in read.elites]
    assert descriptors == [entry["descriptors"] for entry in recorded]
    assert len(read.elites) > 1
    assert read.prompt_trials


@pytest.mark.parametrize("name", ["archive.json", "prompts.json"])
def test_archive_that_the_ledger_does_not_have_is_refused(name: str, run: Path) -> None:
    """What counts as another archive is in tests/evolution/test_files.py."""
    (run / name).write_text("{}")
    with refused(RunError, place=name):
        read_run(run)


@pytest.mark.parametrize(
    "edit",
    [
        lambda described: described["config"]["training"].update({"epochs": 99}),
        lambda described: described["config"]["numerics"].update({"kind": "fast"}),
        lambda described: described["config"].update({"seed": 99}),
        lambda described: described["task"]["instructions"][0].update({"id": "mine"}),
    ],
)
def test_edited_description_is_refused(edit: Callable[[Any], None], run: Path) -> None:
    """Tables of a set-up that the ledger contradicts would be wrong."""
    described = json.loads((run / "run.json").read_text())
    edit(described)
    (run / "run.json").write_text(json.dumps(described))
    with refused(RunError, place="run.json", expected="the configuration, the task and the data"):
        read_run(run)


def family() -> RecordedRun:
    """Return a run whose baseline is its best elite, with a copy of it, and twins among the others."""
    slots = [
        trained(0, 0, 0.1),
        trained(1, 0, 0.3, source="twin"),
        trained(1, 1, 0.2, source="twin"),
        trained(1, 2, 0.15, source="g00s00"),
        *(trained(2, slot, 0.3 + slot) for slot in range(4)),
    ]
    elites = [
        elite(slot.id, niche=niche, fitness=slot.fitness)
        for niche, slot in enumerate(slots)
        if slot.fitness is not None
    ]
    return made(slots, [closed(0), closed(1), closed(2)], elites=elites)


def test_network_that_was_not_measured_has_no_descriptors() -> None:
    """The gate rejected it before."""
    with pytest.raises(ValueError, match="g00s01 was not measured"):
        descriptors_of(candidate("g00s01"), Scale.linear)


def test_best_networks_are_those_of_a_study() -> None:
    """Neither the baseline nor a copy of it nor a better elite's twin is among them, also where there are too few."""
    hand = family()
    assert [best.id for best in hand.best(4)] == ["g01s01", "g02s00", "g02s01", "g02s02"]
    for count in (1, 4, 9):
        chosen = networks_of(hand.candidates, [elite.id for elite in hand.elites], count)
        assert [best.id for best in hand.best(count)] == [network.id for network in chosen[1:]]


@pytest.mark.room("figures", "motifs")
def test_tables_and_figures_look_at_the_same_networks(published: Path) -> None:
    """The top of the motifs and the training curves are the study's variants."""
    from motif_cases import baseline

    from analysis.motifs.motifs import count_motifs
    from analysis.report.figure_list import run_pictures

    hand = family()
    best = [network.id for network in hand.best()]
    anatomies = dict.fromkeys([slot.id for slot in hand.candidates], baseline("force"))
    assert set(count_motifs(hand, anatomies).top_of) == {len(best)}
    niches = load_niches(read_run(published / "run"))
    (curves,) = (one for one in run_pictures(hand, niches) if one.name == "training_curves")
    assert [line.get_label() for line in curves.draw().axes[0].lines] == ["baseline", *best]
