"""Promise: the page's contents are what the records say, candidate by candidate and generation by generation."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_runs import altered, closed, configured, elite, rejected, run, trained

from analysis.report.collection import Collection, collect, tables_of
from analysis.report.page.of_run import RunMaterial, read_texts, run_contents, run_sources
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.source_texts import kept_lines, marked
from analysis.report.sweep_collection import collect_sweep
from analysis.rounding import shown
from analysis.runs.niches import Niches
from analysis.sweeps.ablation import compare_arms
from analysis.tables.dynamics import reestimated
from tacevo.choices import Carrier, Effort
from tacevo.evolution.archive import AddStatus, find_centroids
from tacevo.gate.imports import with_imports
from tacevo.records import to_json
from tacevo.results.run import RecordedRun
from tacevo.storage.sweep_directory import Job

#: Of a run by hand, which has four niches.
NICHES = Niches(
    networks=np.array(find_centroids(niches=4, dimensions=2, samples=100, seed=0)),
    prompts=np.array(find_centroids(niches=4, dimensions=2, samples=100, seed=1)),
)


def contents(given: RecordedRun, texts: dict[str, str] | None = None) -> dict[str, Any]:
    """Return the contents of a run by hand."""
    collection = Collection(run=given, niches=NICHES, studies=(), reestimates=(), left_out=())
    return run_contents(RunMaterial(collection=collection, texts=texts or {}))


@pytest.fixture(scope="module")
def whole(published: Path) -> tuple[Collection, dict[str, Any]]:
    """Return a recorded run with its study, and what its page shows."""
    collection = collect(published / "run")
    material = RunMaterial(
        collection=collection, texts=read_texts(collection.run)[0], tables=tables_of(collection, None)
    )
    return collection, run_contents(material)


@pytest.mark.parametrize("carrier", ["parameter", "words", "effort", "none"])
def test_page_has_what_carries_temperatures(carrier: str) -> None:
    """The sentences, and what each request's temperature chose; nothing new where it is sent as such."""
    chosen: dict[str, Any] = {"level": 2} if carrier in {"words", "effort"} else {}
    chosen |= {"effort": Effort.medium} if carrier == "effort" else {}
    asked = replace(trained(1, 0), carrier=Carrier(carrier), **chosen)
    given = run([trained(0, 0), asked], [closed(0), closed(1)])
    sentences = ("a", "b", "c", "d", "e") if carrier == "words" else ()
    record = replace(given.record, task=replace(given.record.task, boldness=sentences))
    temperature = {} if carrier == "parameter" else {"temperature": {"carrier": carrier}}
    shown = contents(altered(replace(given, record=record), config=configured(**temperature)))
    assert shown.get("boldness", ()) == sentences
    assert shown["settings"]["temperature"].get("carrier", "parameter") == carrier
    line = {name: shown["candidates"][1].get(name) for name in ("carrier", "level", "effort")}
    expected = {"carrier": None if carrier == "parameter" else carrier, "level": None, "effort": None, **chosen}
    assert line == expected


def test_page_says_what_was_not_learned() -> None:
    """Above all else; the trivial loss stands beside the best and the baseline's."""
    held = [elite("g01s00", niche=0, fitness=0.4)]
    given = run([trained(0, 0, 0.5), trained(1, 0, 0.4)], [closed(0, 0.5), closed(1, 0.4)], elites=held)
    at_chance, better = (contents(altered(given, trivial=trivial)) for trivial in (0.41, 0.6))
    assert at_chance["headlines"][1].startswith("Lowest fitness 0.400 by g01s00; ")
    assert "the trivial loss is 0.410" in at_chance["headlines"][1]
    assert at_chance["remarks"][0].startswith("At chance: ")
    assert not any("chance" in one for one in better["remarks"])
    assert "trivial" not in str(contents(given)["headlines"])


def test_last_archive_is_the_recorded_one(whole: tuple[Collection, dict[str, Any]]) -> None:
    """The elites after the last generation are those of archive.json."""
    collection, shown = whole
    assert dict(shown["generations"][-1]["elites"]) == {elite.niche: elite.id for elite in collection.run.elites}


def test_every_candidate_has_its_line_and_its_source(whole: tuple[Collection, dict[str, Any]]) -> None:
    """Fitness, losses and size are the ledger's; the source has the hash of the line."""
    collection, shown = whole
    sources = run_sources(collection.run, read_texts(collection.run)[0])
    for line, one in zip(collection.run.candidates, shown["candidates"], strict=True):
        assert to_json(line).items() <= one.items()
        if line.source is not None:
            assert hashlib.sha256(sources[line.source]["text"].encode()).hexdigest() == line.source
            at, imports = sources[line.source]["given"]
            text = sources[line.source]["text"]
            assert text[:at] + imports + text[at:] == with_imports(text)


def test_network_of_a_study_has_its_reestimates(whole: tuple[Collection, dict[str, Any]]) -> None:
    """One for each seed that trained it again; the others have none."""
    collection, shown = whole
    (study,) = collection.studies
    again = {network.id for network in study.study.networks}
    expected = [study.study.seeds if one["id"] in again else 0 for one in shown["candidates"]]
    assert [len(one["again"]) for one in shown["candidates"]] == expected


def test_study_comes_with_its_seeds_and_tables(whole: tuple[Collection, dict[str, Any]]) -> None:
    """Each network has a value a seed; tables of the study are with it, and with nothing else."""
    collection, shown = whole
    (study,) = shown["studies"]
    assert all(len(network["values"]) == collection.studies[0].study.seeds for network in study["networks"])
    assert {table["caption"] for table in study["tables"]}.isdisjoint(table["caption"] for table in shown["tables"])
    every, name = tables_of(collection, None), collection.studies[0].name
    assert len(study["tables"]) == sum(table.name.split("/")[0] == name for table in every) > 0
    assert len(study["tables"]) + len(shown["tables"]) == len(every)


def test_first_lines_name_task_model_provider_data_and_digest(whole: tuple[Collection, dict[str, Any]]) -> None:
    """Whoever reads a figure must know that no language model answered, and that no sensor was touched."""
    collection, shown = whole
    searched, _, data, _, digest = shown["headlines"]
    assert searched.startswith("Task force, seed 0, requests answered by drawn, portable numerics. ")
    assert data.endswith(" Data source: touches. Requests were written for llm=drawn.")
    assert digest.startswith(f"Digest: {collection.run.digest}. Rules: ")


def test_page_begins_with_what_was_found(whole: tuple[Collection, dict[str, Any]]) -> None:
    """What other seeds leave of the record, beside the baseline, and how many networks a study calls better."""
    collection, given = whole
    again = reestimated(collection.run, collection.reestimates)
    assert again is not None
    words = " ".join(given["found"])
    assert all(shown(loss) in words for loss in again[1:])
    (study,) = collection.studies
    verdicts = list(study.comparisons.verdict[study.comparisons.output.isna()]) if study.comparisons is not None else []
    assert f"{verdicts.count('better')} of {len(verdicts)} network" in words
    assert f"on {study.study.data.counts[2]} images" in words
    sentences = [sentence for line in given["found"] for sentence in line.split(". ")]
    assert max(len(re.findall(r"(?<!\w)\d[\d.,]*", sentence)) for sentence in sentences) <= 3
    alone = replace(collection, studies=(), reestimates=())
    *_, last = run_contents(RunMaterial(collection=alone, texts={}))["found"]
    assert "Single draws" in last


def test_page_has_what_the_makers_noted_of_temperatures(whole: tuple[Collection, dict[str, Any]]) -> None:
    """No record has whether a model acted on its temperature; their note may say it."""
    collection, given = whole
    note = ["Few images.", "The server refuses a sampling Temperature.", "One search."]
    assert run_contents(RunMaterial(collection=collection, texts={}, note=note))["on_temperature"] == [note[1]]
    assert given["on_temperature"] == []


def test_prompts_are_rows_of_named_instructions(whole: tuple[Collection, dict[str, Any]]) -> None:
    """Each is cut into niches of the prompt archive, so that a page can say of how many it could reach which part."""
    collection, given = whole
    assert given["prompt_niches"] == len(collection.niches.prompts)
    assert len(given["prompt_rows"]) == len(given["instructions"])
    assert {niche for row in given["prompt_rows"] for niche, _, _ in row} <= set(range(given["prompt_niches"]))


def test_best_loss_stands_with_what_it_is_worth(whole: tuple[Collection, dict[str, Any]]) -> None:
    """The least of many single trainings flatters; where the networks were trained again, that stands beside it."""
    collection, given = whole
    again = reestimated(collection.run, collection.reestimates)
    assert again is not None
    assert given["headlines"][1].endswith(f" {again[0]}: {shown(again[2])} against the baseline's {shown(again[1])}.")


def test_training_that_two_studies_share_counts_once(whole: tuple[Collection, dict[str, Any]]) -> None:
    """Studies of the same seeds get the same losses from the store."""
    collection, given = whole
    twice = replace(collection, reestimates=collection.reestimates * 2)
    again = run_contents(RunMaterial(collection=twice, texts=read_texts(collection.run)[0]))
    assert again["candidates"] == given["candidates"]


def test_edited_source_is_not_shown(folder: Path) -> None:
    """A file that is not what was trained is named apart from one that is missing, and its candidate has no source."""
    collection = collect(folder / "run")
    source = folder / "run" / "candidates" / "g00s00.py"
    source.write_bytes(source.read_bytes().replace(b"\n", b"\r\n"))  # reads as the same lines, and is another text
    missing = next(path for path in source.parent.glob("*.py") if path != source)
    missing.unlink()
    texts, edited = read_texts(collection.run)
    shown = run_contents(RunMaterial(collection=collection, texts=texts, edited=edited))
    assert "g00s00" not in texts
    assert "no source, because the file was edited: g00s00" in shown["remarks"]
    assert f"no source, because the file is missing: {missing.stem}" in shown["remarks"]


def test_elites_that_moving_bounds_lose_leave_their_niches() -> None:
    """By hand: a far network squeezes two others into one niche, and the better one keeps it."""
    near = [trained(0, 0, 0.5, descriptors=(0.0, 0.0)), trained(0, 1, 0.4, descriptors=(1.0, 1.0))]
    far = trained(1, 0, 0.6, descriptors=(100.0, 100.0))
    shown = contents(run([*near, far], [closed(0, candidates=2), closed(1)], bounds=((0.0, 100.0), (0.0, 100.0))))
    first, second = ([name for _, name in line["elites"]] for line in shown["generations"])
    assert sorted(first) == ["g00s00", "g00s01"]
    assert sorted(second) == ["g00s01", "g01s00"]


def test_archive_without_niches_has_places_and_no_cells() -> None:
    """Its axes are then as long as the networks found so far are apart."""
    lines = [trained(0, 0, 0.5, descriptors=(0.2, 3.0)), trained(1, 0, 0.4, descriptors=(0.7, 1.0))]
    given = run(lines, [closed(0), closed(1)], archive={"kind": "best", "kept": 3}, bounds=None)
    collection = Collection(
        run=given, niches=replace(NICHES, networks=np.empty((0, 2))), studies=(), reestimates=(), left_out=()
    )
    shown = run_contents(RunMaterial(collection=collection, texts={}))
    assert (shown["cells"], shown["places"]) == ((), 3)
    assert [line["extents"] for line in shown["generations"]] == [[(0.2, 0.2), (3.0, 3.0)], [(0.2, 0.7), (1.0, 3.0)]]


def test_one_axis_gives_bands_that_cover_the_map() -> None:
    """By hand: niches at 0.2 and 0.6 meet half-way."""
    given = run([trained(0, 0)], [closed(0)], archive={"axes": ["arch_div"]}, bounds=((0.0, 1.0),))
    collection = Collection(
        run=given, niches=replace(NICHES, networks=np.array([[0.6], [0.2]])), studies=(), reestimates=(), left_out=()
    )
    shown = run_contents(RunMaterial(collection=collection, texts={}))
    assert [(cell[0][0], cell[1][0]) for cell in shown["cells"]] == [(0.4, 1.0), (0.0, 0.4)]


def test_rejected_candidate_has_its_answer_and_no_source() -> None:
    """Where and why it was rejected comes with what the model said."""
    shown = contents(run([trained(0, 0), rejected(0, 1)], [closed(0)]), {"g00s01": "probe: why\n---\nanswer"})
    one = shown["candidates"][1]
    assert (one["stage"], one["reason"], one["source"]) == ("probe", "forward_failed", None)
    assert one["rejected"] == "probe: why\n---\nanswer"


def test_run_in_which_nothing_trained_has_a_page() -> None:
    """There is no elite and no bound to draw."""
    shown = contents(run([rejected(0, 0)], [closed(0, None, trained=0)], bounds=None))
    assert (shown["generations"][0]["elites"], shown["generations"][0]["extents"]) == ([], [])


@pytest.mark.parametrize("text", ["", "\n\n", "a\r\nb\rc", "x = '\U0001f600'  # \u2028", "def f(:\n\t\x00", "'\ud800'"])
def test_marks_cover_every_letter_once(text: str) -> None:
    """Their lengths are those of the text in UTF-16, whatever the text is."""
    marks = marked(text).split()
    assert sum(int(mark[1:]) for mark in marks) == len(text.encode("utf-16-le", "surrogatepass")) // 2
    assert {mark[0] for mark in marks} <= set("tcsnkdb")


def test_marks_tell_keywords_from_strings() -> None:
    """By hand: a keyword, a name, a number and a comment."""
    assert marked("return 'a' + 12 # b") == "k6 t1 s3 t3 n2 t1 c3"


def test_kept_lines_are_alike_on_both_sides() -> None:
    """What is between them was lost or gained."""
    parent, child = ["a", "b", "c", "d"], ["a", "x", "c", "d", "e"]
    kept = kept_lines("\n".join(parent), "\n".join(child))
    assert kept == ((0, 0, 1), (2, 2, 2))
    assert all(parent[a : a + size] == child[b : b + size] for a, b, size in kept)


@pytest.mark.parametrize("kinds", [1, 100])
def test_endless_repetition_is_not_compared(kinds: int) -> None:
    """A comparison takes the product of the lengths or more, and would stop the report: all of it counts as changed."""
    text = "\n".join(str(line % kinds) for line in range(33_000))
    assert kept_lines(text, f"{text}\n0") == ()


@pytest.mark.slow
def test_arms_are_those_of_the_tables(swept: Path) -> None:
    """A band lies between the quartiles, and every seed has an end."""
    collected = collect_sweep(swept / "sweep", swept / "cache")
    shown = sweep_contents(collected)
    assert [arm["name"] for arm in shown["arms"]] == collected.ablation.names
    for arm in shown["arms"]:
        for band in arm["bands"].values():
            middle = np.array(band["median"], dtype=float)
            assert (np.array(band["low"], dtype=float) <= middle).all()
            assert (middle <= np.array(band["high"], dtype=float)).all()
        assert {seed for seed, _ in arm["ends"]["best fitness"]} == {seed for seed, _ in arm["ends"]["coverage"]}


@pytest.mark.slow
def test_arm_that_lost_every_job_is_in_the_tables_and_draws_nothing(swept: Path) -> None:
    """Without a run there is no band and no end."""
    whole = collect_sweep(swept / "sweep", swept / "cache")
    lost = Job(name="lost-seed0", arm="lost", seed=0, overrides=(), config="")
    shown = sweep_contents(replace(whole, ablation=compare_arms(whole.ablation.jobs, failed=[lost])))
    assert "lost" not in {arm["name"] for arm in shown["arms"]}
    assert "lost" in {row[0] for row in shown["tables"][0]["rows"]}


def test_improved_elite_takes_the_niche_of_the_old_one() -> None:
    """The history of a niche names both, one after the other."""
    lines = [trained(0, 0, 0.5), trained(1, 0, 0.4, status=AddStatus.improved)]
    shown = contents(run(lines, [closed(0), closed(1)], elites=[elite("g01s00", niche=0, fitness=0.4)]))
    assert [[name for _, name in line["elites"]] for line in shown["generations"]] == [["g00s00"], ["g01s00"]]
