"""Records that every figure can be drawn from, and every figure with its width."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hand_runs import closed, elite, prompt_trial, rejected, run, trained
from matplotlib.figure import Figure
from studies import study_of

from analysis.figures.by_generation import fitness_evolution, growth, prompt_productivity, temperature, trainable
from analysis.figures.candidates import lineage, training_curves
from analysis.figures.maps import network_map, prompt_map
from analysis.figures.studies import confusion_matrices, forest, seed_boxes
from analysis.runs.dynamics import by_prompt, progress
from analysis.runs.lineage import lineage as find_lineage
from analysis.studies.comparison import compare, of_whole
from tacevo.evolution.archive import find_centroids
from tacevo.records import Kind, Reason, Stage
from tacevo.results.study import RecordedStudy

CENTROIDS = np.array(find_centroids(niches=9, dimensions=2, samples=300, seed=0))

SLOTS = [
    trained(0, 0, 0.8),
    trained(0, 1, 0.6, temperature=0.55, descriptors=(0.2, 11.0)),
    trained(1, 0, 0.4, parents=("g00s01",), prompt=0, temperature=0.62, descriptors=(0.4, 14.0)),
    trained(1, 1, 0.5, parents=("g00s00", "g00s01"), prompt=None),
    rejected(1, 2, Stage.policy, Reason.forbidden_import, prompt=1),
    rejected(2, 0, Stage.extract, Reason.no_class),
]

ELITES = [
    elite("g00s01", niche=2, fitness=0.6),
    elite("g01s00", niche=7, fitness=0.4),
]

TRIALS = (
    prompt_trial(niche=1, prompt=0, temperature=0.6, inserted=True, curiosity=1.7),
    prompt_trial(niche=4, prompt=1, temperature=0.65, inserted=False, curiosity=0.5),
)

RUN = replace(
    run(
        SLOTS,
        [closed(0, 0.6, trained=2, candidates=2), closed(1, 0.4, trained=2, candidates=3), closed(2, None, trained=0)],
        elites=ELITES,
        bounds=((0.1, 0.5), (10.0, 20.0)),
    ),
    prompt_trials=TRIALS,
)

#: Of the archive after each generation.
MEDIANS = [0.7, 0.5, 0.5]

FORCES = study_of({"baseline": [0.006, 0.007, 0.0065], "variant 1": [0.004, 0.005, 0.0045]})

#: With as many seeds as a comparison needs.
TESTED = study_of({"baseline": [0.006, 0.007, 0.0065, 0.0068], "variant 1": [0.004, 0.005, 0.0045, 0.0066]})


def confused() -> RecordedStudy:
    """Return a study of a classification in which every network mistakes one image of class b for a c."""
    networks = ("baseline", "variant 1", "variant 2", "variant 3", "variant 4")
    study = study_of(dict.fromkeys(networks, (0.9, 0.9)), kind=Kind.classification)
    counts = ((4, 0, 0), (0, 2, 1), (0, 0, 3))
    return replace(
        study,
        data=replace(study.data, names=("a", "b", "c")),
        scores=tuple(replace(one, confusion=counts) for one in study.scores),
    )


def of_networks(study: RecordedStudy, count: int) -> RecordedStudy:
    """Keep the first networks of a study."""
    return replace(study, networks=study.networks[:count])


def pareto() -> Figure:
    """Draw a front of which the first network was trained again; this needs the room of that name."""
    from analysis.figures.pareto import pareto
    from analysis.runs.pareto import beside_costs, on_front, with_hypervolumes

    beside = beside_costs(RUN, {"g01s00": (0.45, 0.55, 0.5)})
    return pareto(beside, on_front(beside, ["fitness", "flops"]), "g00s00", with_hypervolumes(RUN, progress(RUN)))


DRAWN: dict[str, tuple[Callable[[], Figure], float]] = {
    "fitness_evolution": (lambda: fitness_evolution(RUN, MEDIANS, {"g00s00": 0.85, "g01s00": 0.7}), 3.5),
    "trainable": (lambda: trainable(progress(RUN)), 3.5),
    "growth": (lambda: growth(RUN, 9, 6), 3.5),
    "temperature": (lambda: temperature(RUN), 3.5),
    "pareto": (pareto, 7.16),
    "network_map": (lambda: network_map(RUN, CENTROIDS), 3.5),
    "prompt_map": (lambda: prompt_map(RUN, CENTROIDS, range(9)), 3.5),
    "prompt_productivity": (lambda: prompt_productivity(by_prompt(RUN)), 3.5),
    "lineage": (lambda: lineage(find_lineage(RUN, "g01s01")), 3.5),
    "training_curves": (lambda: training_curves([SLOTS[0], SLOTS[2]]), 3.5),
    "seed_boxes": (lambda: seed_boxes(FORCES, {"variant 1": "better"}), 3.5),
    "forest": (lambda: forest(TESTED, of_whole(compare(TESTED))), 3.5),
    "confusion_matrix": (lambda: confusion_matrices(of_networks(confused(), 1)), 3.5),
    "confusion_of_two": (lambda: confusion_matrices(of_networks(confused(), 2)), 7.16),
    "confusion_matrices": (lambda: confusion_matrices(confused()), 7.16),
}
