"""Which pictures a run, its studies and a sweep give, with the words below them; how they become files."""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from analysis.figures.ablations import curves, final_values
from analysis.figures.ablations import forest as arms_forest
from analysis.figures.by_generation import fitness_evolution, growth, prompt_productivity, temperature, trainable
from analysis.figures.candidates import lineage, training_curves
from analysis.figures.maps import network_map, prompt_map
from analysis.figures.studies import confusion_matrices, forest, seed_boxes
from analysis.figures.style import render
from analysis.report.collection import Collection
from analysis.report.outputs import Say, left_out, outputs, unsaid
from analysis.report.sweep_collection import SweepCollection
from analysis.rounding import p_in_words, shown
from analysis.runs.archive_history import archive_medians
from analysis.runs.dynamics import by_prompt, progress
from analysis.runs.lineage import lineage as find_lineage
from analysis.runs.niches import Niches, reachable_prompt_niches
from analysis.statistics.effects import LEVEL
from analysis.studies.comparison import Verdict, deciding_p, of_whole
from analysis.studies.reestimates import Reestimates, medians_by_id
from analysis.sweeps.ablation import Ablation
from analysis.table import Percent
from analysis.tables.ablation import common_note, temperature_notes
from tacevo.evolution.lines import TEMPERATURE
from tacevo.parts.registry import Part
from tacevo.records import Kind
from tacevo.results.run import RecordedRun
from tacevo.results.study import RecordedStudy
from tacevo.results.sweep import ALPHA
from tacevo.storage.files import write_durably
from tacevo.text import counted, listed


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure that can be drawn."""

    #: Of its files, without an ending.
    name: str
    caption: str
    draw: Callable[[], Figure]
    #: Whose output draws it; None of ours.
    part: Part | None = None


#: Is called with the name of a picture once it is drawn.
OnDrawn = Callable[[str], object]


def write_pictures(
    pictures: Iterable[Picture], directory: Path, endings: Sequence[str], on_drawn: OnDrawn, say: Say
) -> list[Picture]:
    """Draw pictures into files, each written whole; older ones of the same names are replaced.

    Args:
        pictures: those of somebody's output that raise are left out.
        directory: of the files.
        endings: of `.pdf`, `.svg` and `.png`, which are the formats.
        on_drawn: is called with the name of each.
        say: is called with a sentence on each that is left out.

    Returns:
        Those that were written.

    Raises:
        StoreError: a file cannot be written.
    """
    written = []
    for picture in pictures:
        drawn: dict[str, bytes] = {}
        with contextlib.nullcontext() if picture.part is None else left_out(picture.part, _called(picture), say):
            figure = picture.draw()
            drawn = {ending: render(figure, ending) for ending in endings}
        for ending, content in drawn.items():
            write_durably(directory / f"{picture.name}{ending}", content)
        on_drawn(picture.name)
        written += [picture] if drawn else []
    return written


def _called(picture: Picture) -> str:
    return f"figure {picture.name!r}"


def with_others(own: Iterable[Picture], brought: Iterable[tuple[Part, Picture]], say: Say) -> list[Picture]:
    """Return pictures of ours with those of outputs behind them, but for those that have the name of one of ours."""
    pictures = list(own)
    taken = {picture.name for picture in pictures} | {"samples"}
    for part, picture in brought:
        if part.is_ours:
            continue  # it stands among ours
        if picture.name in taken:
            say(f"no figure {picture.name!r} of {part.name}: expected a name which none of ours has")
        else:
            pictures.append(replace(picture, part=part))
    return pictures


def pictures_of(collection: Collection) -> tuple[Picture, ...]:
    """List every figure of ours of a run and its studies; the names of a study's figures begin with its own."""
    of_outputs = (picture for _, picture in outputs(ours=True).figures(collection, unsaid))
    own = run_pictures(collection.run, collection.niches, collection.reestimates, variants_of(collection))
    pictures = [*own, *of_outputs]
    for compared in collection.studies:
        of_study = study_pictures(compared.study, compared.comparisons)
        pictures += [replace(picture, name=f"{compared.name}/{picture.name}") for picture in of_study]
    return tuple(pictures)


def sweep_pictures(collected: SweepCollection) -> tuple[Picture, ...]:
    """List the figures of a sweep."""
    note = " ".join([common_note(collected.niches_of), *temperature_notes(collected.sweep)])
    ablation = collected.ablation
    reference = ablation.reference
    dotted = "" if reference is None else f", the dotted line is the median of {reference}"
    return (
        Picture(
            name="ablation_curves",
            caption=f"The arms by generation: median over seeds, band between the quartiles. {note}",
            draw=partial(curves, collected.ablation, collected.curves),
        ),
        Picture(
            name="ablation_finals",
            caption=f"The arms at the end: points are seeds, boxes quartiles, whiskers all seeds{dotted}. {note}",
            draw=partial(final_values, collected.ablation),
        ),
        *([] if reference is None or len(ablation.names) < 2 else [_arms_forest(ablation)]),
    )


def _arms_forest(ablation: Ablation) -> Picture:
    words = (
        f"What each arm differs from {ablation.reference} by, in {ablation.first.value}: the difference of medians "
        f"over seeds, with its {100 * LEVEL:g} % interval; filled where p after Holm is at most {ALPHA:g}."
    )
    return Picture(name="ablation_forest", caption=words, draw=partial(arms_forest, ablation))


def variants_of(collection: Collection) -> dict[str, str]:
    """Return what studies call candidates, by id, where all of them call one alike: `g12s05 (variant 1)`."""
    called: dict[str, set[str]] = {}
    for compared in collection.studies:
        for network in compared.study.networks:
            called.setdefault(network.id, set()).add(network.whole_name)
    return {name: names.pop() for name, names in called.items() if len(names) == 1}


def run_pictures(
    run: RecordedRun, niches: Niches, reestimates: Sequence[Reestimates] = (), names: Mapping[str, str] | None = None
) -> tuple[Picture, ...]:
    """List the figures of a run; what it never had is left out: a prompt archive, instructions, a trained network.

    `names` are those of candidates that studies name, as of `variants_of`.
    """
    has_prompts = run.has_prompts
    reached = reachable_prompt_niches(run, niches.prompts) if has_prompts else frozenset()
    unsent = f"; {run.not_sent[TEMPERATURE]}" if TEMPERATURE in run.not_sent else ""
    pictures: list[Picture] = []

    def add(name: str, words: str, draw: Callable[[], Figure]) -> None:
        pictures.append(Picture(name=name, caption=f"{words} ({run.name}).", draw=draw))

    again = medians_by_id(reestimates)
    words = "Best and median fitness of the network archive after each generation, and the median of its new candidates"
    words += ", beside the baseline"
    if again:
        words += "; diamonds are medians of other training seeds, each joined to the fitness on record"
    add("fitness", words, partial(fitness_evolution, run, archive_medians(run, niches.networks), again))
    if not _all_trained(run):
        words = "First answers that were trained, and what became of the others"
        add("trainable", words, partial(trainable, progress(run)))
    words = "Coverage of the network archive, and its QD-score"
    if reached:
        covered = run.generations[-1].prompt_coverage
        words = (
            f"Coverage of both archives, and QD-score of the networks. Prompts: of the {len(reached)} niches that the "
            f"temperature rule could reach; of all {len(niches.prompts)}, as tables count them, "
            f"{shown(Percent(covered))} are held at the end"
        )
    add("archive_growth", words, partial(growth, run, len(niches.prompts), len(reached)))
    add(
        "temperature",
        f"Temperature{run.carried} of each generation, and of its requests{unsent}",
        partial(temperature, run),
    )
    if _has_map(run):
        words = "The network archive; each cell is a niche"
        add("network_map", words, partial(network_map, run, niches.networks))
    if has_prompts:
        words = (
            f"The prompt archive over instruction and temperature{run.carried}" if run.carried else "The prompt archive"
        )
        words += f", a row for each instruction, cut into niches{unsent}"
        if len(reached) < len(niches.prompts):
            words += (
                ". No search could reach the shaded ones, because the temperature rule leads to no temperature in them"
            )
        add("prompt_map", words, partial(prompt_map, run, niches.prompts, reached))
    if run.instructions:
        words = "Children of each instruction that entered the network archive"
        add("prompt_productivity", words, partial(prompt_productivity, by_prompt(run)))
    if run.elites:
        first = run.ranked()[0].id
        words = f"The ancestors of {first}, the best network"
        add("lineage", words, partial(lineage, find_lineage(run, first)))
        words = "Short training of the baseline and the best networks"
        add("training_curves", words, partial(training_curves, [run.baseline, *run.best()], names))
    return tuple(pictures)


def undrawn(run: RecordedRun) -> tuple[str, ...]:
    """List the figures that a run cannot have, with the reason, a sentence each."""
    said = []
    if _all_trained(run):
        said.append(
            f"no trainable: all {counted(len(run.answered), 'first answer')} were trained, so all bars are whole"
        )
    if not run.has_niches:
        said.append("no network_map: archive.kind=best keeps the best of all networks, and has no niches to draw")
    elif not _has_map(run):
        axes = listed(run.config.archive.axes)
        said.append(f"no network_map: archive.axes={axes}, and a map needs two axes")
    if not run.has_prompts:
        said.append(f"no prompt_map: prompts.policy={run.config.prompts.policy} keeps no prompt archive")
    return tuple(said)


def _all_trained(run: RecordedRun) -> bool:
    """Answer whether no first answer was rejected or skipped."""
    rest = [line for line in run.candidates if line.stage is not None or line.skipped or line.repairs]
    return len(run.candidates) > 0 and not rest


def _has_map(run: RecordedRun) -> bool:
    return run.has_niches and len(run.config.archive.axes) == 2


def study_pictures(study: RecordedStudy, comparisons: pd.DataFrame | None) -> tuple[Picture, ...]:
    """List the figures of a study; without comparisons its boxes have no verdicts."""
    verdicts = {
        one.network: f"{one.verdict}\np {p_in_words(deciding_p(one))}" for one in of_whole(comparisons).itertuples()
    }
    equal = ", and of an equivalent network that of the test of equivalence"
    ending = f"; p is Holm's{equal if Verdict.equivalent in set(of_whole(comparisons).verdict) else ''}."
    ending = ending if verdicts else "."
    data = ", ".join(part for part in (study.task, study.where, study.trained_with) if part)
    words = (
        f"Test results of {study.seeds} training seeds of each network ({data}). Points are seeds, boxes "
        f"quartiles, the dotted line is the baseline's median{ending}"
    )
    pictures = [
        Picture(name="seed_boxes", caption=words, draw=partial(seed_boxes, study, verdicts, "verdict\np after Holm"))
    ]
    if verdicts:
        words = (
            f"What each network differs from the baseline by ({data}): the difference of medians over {study.seeds} "
            f"training seeds, with its {100 * LEVEL:g} % interval; the band is the margin of equivalence{ending}"
        )
        pictures.append(Picture(name="forest", caption=words, draw=partial(forest, study, of_whole(comparisons))))
    if study.kind is Kind.classification:
        words = (
            "Test images of each network by true and predicted class: counts, and below them per cent of the true "
            f"class. Of its {study.seeds} training seeds, each network is shown at the one whose accuracy is the "
            "median: the lower one of two in the middle, and the first where several seeds have it."
        )
        draw = partial(confusion_matrices, study)
        pictures.append(Picture(name="confusion_matrices", caption=words, draw=draw))
    return tuple(pictures)
