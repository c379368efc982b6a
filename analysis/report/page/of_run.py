"""What the page shows of one run, as JSON: its ledger lines with what stands beside them, under names the script reads.

Texts of candidates, models and names stand here as they came. They are data to the page's script, which sets them as
text only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.report.collection import Collection, Compared
from analysis.report.outputs import outputs
from analysis.report.page.finding import found
from analysis.report.page.source_texts import kept_lines, source_contents
from analysis.rounding import p_in_words, shown
from analysis.runs.archive_history import archive_history, archive_medians
from analysis.runs.coverage_map import DIRECTIONS, axis_label, descriptors
from analysis.runs.dynamics import by_prompt, by_temperature, progress
from analysis.runs.niches import cells, prompt_rows, reachable_prompt_niches
from analysis.studies.comparison import Verdict, deciding_p, of_whole
from analysis.studies.metric_names import SHARES, metric_name
from analysis.studies.reestimates import by_seeds, losses_by_source, medians_by_id
from analysis.table import Table
from analysis.tables.comparison import margin_in_words
from analysis.tables.dynamics import reestimated
from analysis.tables.rendering import numeric_columns
from tacevo.config.identity import identity
from tacevo.evolution.lines import TEMPERATURE, CandidateLine, why_not_sent
from tacevo.evolution.run_files import rules_in_words
from tacevo.records import Kind, Stage, to_json
from tacevo.results.grouped import in_groups
from tacevo.results.run import RecordedRun
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.summary import data_in_words, outcome_in_words, rates_in_words, searched

#: Corners of a polygon in order, each (x, y) in [0, 1].
Corners = tuple[tuple[float, float], ...]

#: Decimals of a cell's corners: a thousandth of a pixel.
_CORNERS = 5


def read_texts(run: RecordedRun) -> tuple[dict[str, str], list[str]]:
    """Read the candidates' files.

    Returns:
        By candidate, the source that its line has the hash of, or of a rejected one the reason and the answer; and the
        candidates whose file has another source than their line.
    """
    texts, edited = {}, []
    for line in run.candidates:
        kept, is_edited = run.directory.read_checked(line.id, line.source)
        if is_edited:
            edited.append(line.id)
        elif kept is not None:
            texts[line.id] = kept.decode(errors="replace")
    return texts, edited


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMaterial:
    """What the page of a run is made from."""

    collection: Collection
    #: As `read_texts`.
    texts: Mapping[str, str]
    edited: Sequence[str] = ()
    #: Of the run and its studies.
    tables: Sequence[Table] = ()
    #: Sentences that stand above all, those of the makers' note among them.
    remarks: Sequence[str] = ()
    #: The paragraphs of that note.
    note: Sequence[str] = ()
    #: Sample images, as a `data:` address.
    samples: str | None = None
    #: Of installed outputs, as of `sections_contents`.
    sections: Sequence[Mapping[str, Any]] = ()


def run_contents(given: RunMaterial) -> dict[str, Any]:
    """Return all that the page shows of a run but its sources (`run_sources`), as JSON.

    `cells` are the corners of every niche of the network archive, none where it has no niches, and `places` how many
    elites it can hold; `unreachable` the niches of the prompt archive that no trial could reach; `directions` the words
    for the low and the high end of each axis, None of a user's own; `on_temperature` the paragraphs of the makers' note
    that speak of temperatures, whose effect no record has.
    """
    collection, tables = given.collection, given.tables
    run, task = collection.run, collection.run.record.task
    has_prompts = run.has_prompts
    reached = reachable_prompt_niches(run, collection.niches.prompts) if has_prompts else frozenset()
    return {
        "name": run.name,
        "found": found(collection),
        "headlines": _headlines(collection),
        "remarks": [*([run.shortfall] if run.shortfall else []), *given.remarks, *_sourceless(given)],
        "again": medians_by_id(collection.reestimates),
        "axes": [axis_label(axis, run.config.archive.eff_ratio_scale) for axis in run.config.archive.axes],
        "directions": [DIRECTIONS.get(axis) for axis in run.config.archive.axes],
        "cells": _cells(collection.niches.networks),
        "places": run.places,
        "instructions": to_json(task.instructions),
        "crossover": task.crossover,
        **({"boldness": task.boldness} if task.boldness else {}),
        **({"why_not_sent": why_not_sent(TEMPERATURE, thinks=True)} if run.config.llm.thinks else {}),
        "on_temperature": [words for words in given.note if "temperature" in words.lower()],
        "candidates": _candidates(collection, given.texts),
        "generations": _generations(run, collection.niches.networks),
        "pareto": _pareto(collection),
        "prompt_niches": len(collection.niches.prompts) if has_prompts else 0,
        "prompt_rows": prompt_rows(collection.niches.prompts, len(run.instructions)) if has_prompts else (),
        "unreachable": sorted(set(range(len(collection.niches.prompts))) - reached) if has_prompts else [],
        "trials": to_json(run.prompt_trials),
        "by_instruction": _rows(by_prompt(run)),
        "by_temperature": _rows(by_temperature(run)),
        "studies": [_study(compared, tables) for compared in collection.studies],
        "tables": [table_contents(table) for table in tables if not _of_study(table, collection.studies)],
        "sections": given.sections,
        "samples": given.samples,
        "provenance": _provenance(run),
        "settings": identity(run.config),
    }


def run_sources(run: RecordedRun, texts: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return the sources of a run's candidates by their hash, as `source_contents` does."""
    known = {line.source: texts[line.id] for line in run.candidates if line.source and line.id in texts}
    return {source: source_contents(text) for source, text in known.items()}


def table_contents(table: Table) -> dict[str, Any]:
    """Return a table with rounded cells, and which of its columns hold numbers."""
    return {
        "caption": table.caption,
        "columns": table.columns,
        "numeric": numeric_columns(table),
        "rows": [[shown(cell) for cell in row] for row in table.rows],
        "notes": table.notes,
    }


def _sourceless(given: RunMaterial) -> list[str]:
    there = {*given.texts, *given.edited}
    missing = [line.id for line in given.collection.run.candidates if line.source is not None and line.id not in there]
    lost = {"the file was edited": given.edited, "the file is missing": missing}
    return [f"no source, because {why}: {', '.join(names)}" for why, names in lost.items() if names]


def _headlines(collection: Collection) -> list[str]:
    """Say what was searched and found, as summary.md does; with which data; and what it rests on."""
    run, again = collection.run, reestimated(collection.run, collection.reestimates)
    provider = f" Requests were written for llm={run.config.llm.provider}." if run.answered else ""
    trained_again = ""
    if again is not None:
        words, reference, median = again
        trained_again = f" The lowest, {words}: {shown(median)} against the baseline's {shown(reference)}."
    lines = [
        searched(run),
        outcome_in_words(run)[0] + trained_again,
        f"{data_in_words(run)} Data source: {run.config.data.source}.{provider}",
        " ".join(rates_in_words(run)),
        f"Digest: {run.digest}. Rules: {rules_in_words(run.rules)}.",
    ]
    return [line for line in lines if line]


def _cells(centroids: NDArray[np.float64]) -> tuple[Corners, ...]:
    """Return the cells of an archive of two axes, or the bands of one axis; none without niches."""
    if centroids.shape[1] == 1 and len(centroids):
        return _bands(centroids[:, 0])
    polygons = cells(centroids) if len(centroids) else ()
    return tuple(tuple((x, y) for x, y in polygon.round(_CORNERS).tolist()) for polygon in polygons)


def _bands(centres: NDArray[np.float64]) -> tuple[Corners, ...]:
    """Cut [0, 1] half-way between neighbours; a band is as high as the map."""
    order = np.argsort(centres)
    inner = (centres[order][1:] + centres[order][:-1]) / 2
    edges = np.concatenate([[0.0], inner, [1.0]]).round(_CORNERS).tolist()
    corners: dict[int, Corners] = {}
    for niche, low, high in zip(order.tolist(), edges, edges[1:], strict=False):
        corners[niche] = ((low, 0.0), (high, 0.0), (high, 1.0), (low, 1.0))
    return tuple(corners[niche] for niche in range(len(centres)))


def _candidates(collection: Collection, texts: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the ledger line of every candidate, with what the page says beside it.

    `again` are the fitnesses of further trainings with other seeds; `point` the descriptors on the archive's axes, none
    where nothing was measured. `changes` are the lines that it kept of each parent; `rejected` is the reason in words
    and the model's answer.
    """
    run, again = collection.run, by_seeds(collection.reestimates)
    points = dict(zip((line.id for line in run.trained), descriptors(run).tolist(), strict=True))
    sources = {line.id: texts[line.id] for line in run.candidates if line.source is not None and line.id in texts}
    return [
        to_json(line)
        | {
            "again": next((values for one in again if (values := one.estimates_of(line.id))), ()),
            "point": points.get(line.id, ()),
            "changes": _changes(line, sources),
            "rejected": texts.get(line.id) if line.source is None else None,
        }
        for line in run.candidates
    ]


def _changes(line: CandidateLine, sources: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return which lines a candidate kept of each parent (`kept_lines`), as far as both sources are there."""
    return [
        {"parent": parent, "kept": kept_lines(sources[parent], sources[line.id])}
        for parent in dict.fromkeys(line.parents)
        if parent in sources and line.id in sources
    ]


def _generations(run: RecordedRun, centroids: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Return the ledger line of every generation, with what the page says beside it.

    `rejected` counts first answers by stage; `tokens` and `usd` are what its answers cost, None where that is not known
    of all of them; `hypervolume` is that in loss and FLOPs so far, None without a reference point; `extents` (low,
    high) of each axis that its niches were looked up under, none before anything was trained; `elites` (niche or place,
    id) of the network archive after it.
    """
    medians, archives = archive_medians(run, centroids), archive_history(run, centroids)
    raw, volumes = descriptors(run), _hypervolumes(run)
    born = np.array([line.generation for line in run.trained])
    return [
        to_json(line)
        | {
            "rejected": {stage.value: entry[f"rejected_{stage}"] for stage in Stage},
            "archive_median": median,
            "tokens": entry["tokens"],
            "usd": entry["usd"],
            "hypervolume": volume,
            "extents": list(zip(line.bounds.low, line.bounds.high, strict=True))
            if line.bounds is not None
            else _extents(raw[born <= line.generation]),
            "elites": [(niche, elite.name) for niche, elite in sorted(archive.elites.items())],
        }
        for entry, line, median, archive, volume in zip(
            _rows(progress(run)), run.generations, medians, archives, volumes, strict=True
        )
    ]


def _hypervolumes(run: RecordedRun) -> list[float | None]:
    """Return the hypervolume after each generation; None without a reference point, or where the part is missing."""
    if not outputs(ours=True).has("pareto"):
        return [None] * len(run.generations)
    from analysis.runs.pareto import hypervolumes

    return hypervolumes(run)


def _pareto(collection: Collection) -> dict[str, Any]:
    """Return the fitnesses that are re-estimates, by id, and the ids of the front in loss and FLOPs.

    Without re-estimates that were made the front would be another one, so there is none.
    """
    if collection.unread or not outputs(ours=True).has("pareto"):
        return {"again": {}, "front": []}
    from analysis.runs.pareto import REESTIMATED, beside_costs, on_front

    candidates = beside_costs(collection.run, losses_by_source(collection.reestimates))
    again = candidates.fitness[candidates.estimate == REESTIMATED]
    return {"again": again.to_dict(), "front": on_front(candidates, ["fitness", "flops"]).index.tolist()}


def _extents(points: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Return (low, high) of each axis, for an archive that has no bounds; [] before anything was trained."""
    return list(zip(points.min(0).tolist(), points.max(0).tolist(), strict=True)) if len(points) else []


def _rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = frame.astype(object).where(frame.notna(), None).to_dict("records")
    return rows


def _of_study(table: Table, studies: Sequence[Compared]) -> bool:
    """Return whether a table is a study's: its name then begins with the study's (`collection.tables_of`)."""
    return any(table.name.startswith(f"{compared.name}/") for compared in studies)


def _verdict(study: RecordedStudy, comparison: Any) -> str:
    """Write a verdict with the p of the test that gave it."""
    p = f"p after Holm {p_in_words(deciding_p(comparison))}"
    if comparison.verdict != Verdict.equivalent:
        return f"{comparison.verdict}, {p}"
    return f"{comparison.verdict}, {p} of equivalence, margin {margin_in_words(study, comparison.margin)}"


def _study(compared: Compared, tables: Sequence[Table]) -> dict[str, Any]:
    """Return a study: of each network the primary metric of every seed, and its comparison with the baseline, if any.

    `confusion` counts test images by (true class, predicted class) under its median seed; None of a regression.
    """
    study = compared.study
    variants = of_whole(compared.comparisons).itertuples()
    verdicts = {one.network: _verdict(study, one) for one in variants}
    matrices = {(score.network, score.seed): score.confusion for score in study.scores}
    is_classification = study.kind is Kind.classification
    networks = [
        {
            "name": network.whole_name,
            "id": network.id,
            "values": study.values(network.name, study.primary).tolist(),
            "verdict": verdicts.get(network.name),
            "confusion": matrices[network.name, study.median_seed(network.name)] if is_classification else None,
        }
        for network in study.networks
    ]
    return {
        "name": compared.name,
        "metric": metric_name(study.primary),
        "is_share": study.primary in SHARES,
        "lower_is_better": LOWER_IS_BETTER[study.primary],
        "names": study.names,
        "networks": networks,
        "tables": [table_contents(table) for table in tables if _of_study(table, [compared])],
    }


def _provenance(run: RecordedRun) -> tuple[tuple[str, str], ...]:
    train, validation, test = run.facts.counts
    code = run.record.code
    commit = "not known" if code is None else f"{code.commit}{' and changes since' if code.dirty else ''}"
    walls = {}
    for number, measures in enumerate(run.record.confinement, start=1):
        words = "; ".join(f"{name}: {state}" for name, state in measures.items())
        walls["confinement" if len(run.record.confinement) == 1 else f"confinement {number}"] = words
    facts = {
        "run": run.name,
        "digest": run.digest,
        "task": run.task,
        "seed": str(run.config.seed),
        **({"model": run.model, "requests written for": f"llm={run.config.llm.provider}"} if run.answered else {}),
        "data source": str(run.config.data.source),
        "data fingerprint": run.facts.fingerprint,
        "images": f"{train:,} to train, {validation:,} to validate, {test:,} to test{in_groups(run.facts)}",
        "numerics": str(run.config.numerics.kind),
        "rules": rules_in_words(run.rules),
        "commit": commit,
        **{f"version of {name}": number for name, number in run.record.versions.items()},
        **{f"machine: {name}": "none" if value is None else str(value) for name, value in run.record.machine.items()},
        **walls,
    }
    return tuple(facts.items())
