"""Promise: whoever edits a published run is found out, also where all checksums were written anew; nothing is left.

What nobody can find from a bundle alone, and hence is not part of the promise: figures and pages whose checksums were
written anew (the bundle's digest is another one then), and records that were all made up to fit each other, which
`--retrain` finds.
"""

import io
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from _pytest.mark import ParameterSet
from bundles import Members, Refused, entries_of, honest, members_of, resealed, with_entries, with_line
from rich.console import Console

from tacevo.bundles.format import STORE
from tacevo.bundles.open import opened
from tacevo.bundles.verify import verify
from tacevo.cli.app import main
from tacevo.config.schema import MOST
from tacevo.errors import BundleError
from tacevo.runs.progress import Progress
from tacevo.storage.canonical import canonical, readable
from tacevo.storage.ledger import GENESIS, seal
from tacevo.storage.run_directory import MANIFEST
from tacevo.storage.store import KINDS


@pytest.fixture
def whole(published: Path) -> Members:
    """Return the members of a sound bundle."""
    return members_of(published / "run.zip")


@pytest.fixture(autouse=True)
def _nothing_stays_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Keep temporary files in a directory of their own, which must be empty at the end."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    yield
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Replay bundles in a directory of the test's own."""
    return Refused(tmp_path, capsys)


def verify_at(bundle: Path) -> None:
    """Verify a bundle's searches and studies, without its tables."""
    place = opened(bundle)
    with Progress(Console(file=io.StringIO())) as view:
        verify(place, lambda run, store: {}, view)


def few_of(names: Sequence[str], contents: Sequence[Any]) -> list[ParameterSet]:
    """Pair each content with one name; all other pairs are brute force."""
    return [
        pytest.param(name, content, marks=[] if at % len(names) == place else pytest.mark.long)
        for at, content in enumerate(contents)
        for place, name in enumerate(names)
    ]


def without(members: Members, name: str) -> Members:
    """Leave a member out."""
    return {other: data for other, data in members.items() if other != name}


def replaced(members: Members, name: str, old: bytes, new: bytes) -> Members:
    """Put a text in the place of the first that fits a pattern; a member that is not there is empty."""
    edited = {**members, name: re.sub(old, new, members.get(name, b""), count=1)}
    assert edited != members
    return edited


def answered(members: Members, kind: str, field: tuple[str | int, ...], change: Callable[[Any], Any]) -> Members:
    """Change a field of the answer of the first entry of a kind."""
    entries = entries_of(members)
    answer = next(entry for entry in entries if entry["kind"] == kind)["answer"]
    for name in field[:-1]:
        answer = answer[name]
    answer[field[-1]] = change(answer[field[-1]])
    return with_entries(members, entries)


def described(members: Members, **changes: Any) -> Members:
    """Change study.json."""
    name = next(name for name in members if name.endswith("study.json"))
    return {**members, name: json.dumps({**json.loads(members[name]), **changes}).encode()}


@pytest.mark.room("publishing")
def test_replay_needs_nothing_but_the_bundle(published: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In an empty directory, it says what was compared, and ends with the run's digest."""
    assert main(["replay", str(published / "run.zip")]) == 0
    said = capsys.readouterr().out
    digest = json.loads((published / "run" / "run.json").read_text())["digest"]
    assert said.endswith(f"digest: {digest}\n")
    assert all(words in said for words in ("ledger lines", "study elites1-seeds4", "bundle digest: "))
    verdict = r"EQUAL: search, 1 study, \d+ files of tables; not compared: \d+ figures \(their checksums hold\)"
    assert re.fullmatch(verdict, said.splitlines()[-2])
    assert {path.name for path in place.iterdir()} == {"temporary"}


@pytest.mark.slow
def test_retraining_works_on_a_bundle(published: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The data set is made as for a run directory, in a directory that is yet to be made; a training is as it was."""
    assert main(["replay", str(published / "run.zip"), "--retrain", "1", "--store", "new"]) == 0
    assert [path.name for path in (place / "new").iterdir()] == ["data"]
    said = capsys.readouterr().out
    assert "retrained: 3 of " in said  # the best network, the baseline of its study, and another one


def test_members_are_held_against_the_manifest(whole: Members, refused: Refused) -> None:
    """One letter more in a ledger, source, table, figure, page or the packed store; a member more or less."""
    table, figure = (next(name for name in whole if name.startswith(folder)) for folder in ("tables/", "figures/"))
    for name in ("run/ledger.jsonl", "run/candidates/g00s00.py", "run/run.json", "README.md", STORE, table, figure):
        refused({**whole, name: whole[name] + b"\n"}, f"got '{name}' was edited or damaged", seal=False)
    refused(without(whole, table), f"'{table}' is missing", seal=False)
    refused({**whole, "tables/mine.csv": b"1"}, "'tables/mine.csv' is not listed", seal=False)
    refused({**whole, "setup.py": b"1"}, "only files of its kind", seal=False)
    less = without(whole, "run/summary.md")
    for members in (less, honest(less)):
        refused(members, "x.zip: expected a published run or sweep; got a file without run/summary.md", seal=False)
    lines = whole[MANIFEST].decode().splitlines()
    name = lines[0].split("  ")[1]
    edited = "\n".join([f"{'0' * 64}  {name}", *lines[1:]]) + "\n"
    refused({**whole, MANIFEST: edited.encode()}, f"'{name}' was edited or damaged", seal=False)
    refused({**whole, MANIFEST: b"nonsense"}, f"{MANIFEST}, line 1: expected", seal=False)


# From here on the attacker writes every checksum anew.


def test_edited_ledger_line_is_found(whole: Members, refused: Refused) -> None:
    """Alone, it breaks the chain; with the chain made anew, generation, slot, field and both values are named."""
    better = {**whole, "run/ledger.jsonl": whole["run/ledger.jsonl"].replace(b'"fitness":0.', b'"fitness":0.0', 1)}
    assert better != whole
    refused(better, "x.zip, run/ledger.jsonl, line 2 (g00s00): expected a line that matches its hash")
    refused(better, "got 'run/ledger.jsonl', line 2 (g00s00), was edited or damaged", seal=False)

    def improve(line: dict[str, Any]) -> None:
        line["fitness"] = 0.000001

    edited = with_line(whole, 1, improve)
    refused(edited, "g00s00 (generation 0, slot 0), fitness: expected 1e-06 as recorded; got 0.")


FOREIGN: dict[str, Any] = {"kind": "probes", "request": "of another run", "answer": {}}

EDITS: list[tuple[Callable[[Members], Members], str]] = [
    (
        lambda whole: answered(whole, "evaluations", ("training", "validation_losses", -1), lambda loss: loss / 2),
        " as recorded; got ",
    ),
    (
        lambda whole: answered(whole, "completions", ("text",), lambda text: f"{text}\n# edited"),
        "no recorded answer for",
    ),
    (
        lambda whole: answered(whole, "studies", ("full", "metrics", "mse"), lambda _: 0.0),
        ", metrics.mse: expected ",
    ),
    (lambda whole: answered(whole, "arrays", ("base64",), lambda text: f"AAAA{text[4:]}"), "got bytes of the digest "),
    (
        lambda whole: with_entries(whole, [entry for entry in entries_of(whole) if entry["kind"] != "arrays"]),
        "expected an array of shape",
    ),
    (lambda whole: with_entries(whole, [*entries_of(whole), FOREIGN]), "only entries that the replay reads"),
    (lambda whole: without(whole, "tables/gate.md"), "table gate.md: expected the tables of this release; got none"),
    (lambda whole: replaced(whole, "tables/wishes.csv", rb"\Z", b"a,b\r\n"), "table wishes.csv: expected the tables"),
    (
        lambda whole: replaced(whole, "tables/more/generations.tex", rb"\\toprule", rb"\\midrule"),
        "table more/generations.tex: line ",
    ),
    (
        lambda whole: replaced(whole, "run/timings.jsonl", rb'"output_tokens":\s*\d+', b'"output_tokens":12345'),
        "timings.jsonl, g00s00: expected ",
    ),
    (
        lambda whole: replaced(whole, "run/archive.json", rb'"coverage": [\d.]+', b'"coverage": 1.5'),
        "archive.json, coverage: expected ",
    ),
    (
        lambda whole: replaced(whole, "run/prompts.json", rb'"coverage": [\d.]+', b'"coverage": 1.5'),
        "prompts.json, coverage: expected ",
    ),
    (
        lambda whole: replaced(whole, "run/candidates/g00s01.py", rb"\Z", b"# mine\n"),
        "candidates/g00s01.py: expected the text that was judged",
    ),
    (
        lambda whole: replaced(whole, "run/candidates/g99s99.py", rb"\Z", b"class Mine: pass\n"),
        "expected only files of the ledger; got g99s99.py",
    ),
    (lambda whole: replaced(whole, "run/summary.md", rb"Lowest fitness 0", b"Lowest fitness -0"), "summary.md: line "),
    # It is not replayed, so its files belong to nothing.
    (lambda whole: described(whole, digest=None), "expected only files of a study of this run; got elites1-seeds4"),
    (
        lambda whole: replaced(whole, "run/run.json", rb'"class_name": "\w+"', b'"class_name": "Another"'),
        "x.zip, run/run.json, task.",
    ),
]


@pytest.mark.few(8)
@pytest.mark.parametrize("edit", EDITS)
def test_edit_is_found(edit: tuple[Callable[[Members], Members], str], whole: Members, refused: Refused) -> None:
    """A better training, another answer, others' predictions, a file more or less: the place is named."""
    change, words = edit
    refused(change(whole), words)


@pytest.mark.parametrize("kind", ["answers", "completions", "evaluations", "probes"])
def test_missing_entry_is_told_with_its_place(kind: str, whole: Members, refused: Refused) -> None:
    """Generation and slot, and nothing of recording anew, which no reader of a bundle can."""
    entries = entries_of(whole)
    gone = next(place for place, entry in enumerate(entries) if entry["kind"] == kind)
    bundle = refused(
        with_entries(whole, entries[:gone] + entries[gone + 1 :]), f"no recorded answer for {kind} request"
    )
    with pytest.raises(BundleError, match=r"generation \d, slot \d, .*: no recorded answer for") as told:
        verify_at(bundle)
    assert "llm.mode=record" not in str(told.value)
    assert "fetch the bundle again: an entry that its replay reads was removed" in str(told.value)


def test_study_under_another_name_is_found(whole: Members, refused: Refused) -> None:
    """Directory and study.json alike, with its tables: more seeds in a name than in the study, say.

    Where another version made it, that is told beside its failure.
    """
    old = next(name for name in whole if name.endswith("study.json")).split("/")[2]
    new = old.replace("seeds4", "seeds40")
    study = json.loads(whole[f"run/studies/{old}/study.json"])
    renamed = {name.replace(old, new): data for name, data in whole.items()}
    renamed[f"run/studies/{new}/study.json"] = json.dumps({**study, "name": new}).encode()
    refused(renamed, f": expected {old}")
    refused(described(whole, name=new), f": expected {old}")
    other = described(whole, versions={**study["versions"], "tacevo": "0"}, terms={**study["terms"], "alpha": 0.5})
    refused(other, "another version may be the reason: tacevo is ")


def test_no_raw_text_reaches_the_terminal(whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A version, say, that would clear the screen: in what is said, and in an error."""
    run = json.loads(whole["run/run.json"])
    run["versions"]["torch"] = "\x1b[2J2.0"
    sound = resealed({**whole, "run/run.json": readable(run).encode()}, tmp_path / "x.zip")
    assert main(["replay", str(sound)]) == 0
    broken = {**whole, "run/run.json": json.dumps(run).encode(), "run/archive.json": b"{}"}
    assert main(["replay", str(resealed(broken, tmp_path / "y.zip"))]) == 1
    said = "".join(capsys.readouterr())
    assert r"\x1b[2J2.0" in said
    assert "\x1b" not in said


def test_sizes_beyond_reason_are_refused_at_once(whole: Members, refused: Refused) -> None:
    """A few digits in run.json or study.json must not ask for all memory there is."""
    run = json.loads(whole["run/run.json"])
    for key in ("generations", "candidates", "initial"):
        config = {**run["config"], "search": {**run["config"]["search"], key: MOST}}
        edited = {**whole, "run/run.json": json.dumps({**run, "config": config}).encode()}
        begun = "expected the configuration, the task and the data that the ledger begins with"
        refused(edited, "lines, by run.json; got " if key == "generations" else begun)
    refused(described(whole, seeds=10**12), "expected 2000000000000")


COUNTS = [
    *("search.generations", "search.candidates", "search.initial", "task.outputs", "task.images", "data.images"),
    *("data.image_size", "archive.niches", "archive.prompt_niches", "archive.samples", "archive.kept", "prompts.pool"),
    *("proposals.best", "proposals.repair_attempts", "training.epochs", "training.batch_size"),
    *("llm.concurrency", "executor.workers", "executor.per_gpu"),
]


@pytest.mark.few(1)
@pytest.mark.parametrize("command", ["replay", "show", "report", "tables"])
def test_count_beyond_all_bounds_is_told_by_its_key(
    command: str, whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is made of it, whichever command reads the bundle, and whether or not it has an effect."""
    for key in COUNTS:
        run = json.loads(whole["run/run.json"])
        group, _, name = key.partition(".")
        run["config"][group][name] = 10**9 + 1
        bundle = resealed({**whole, "run/run.json": readable(run).encode()}, tmp_path / "x.zip")
        output = ["-o", str(tmp_path / "out")] if command in {"report", "tables"} else []
        assert main([command, str(bundle), *output]) in {1, 2}
        (said,) = [line for line in capsys.readouterr().err.splitlines() if "1000000001" in line]
        assert f"x.zip, run/run.json: expected a configuration of this version; got {key}: expected an integer" in said


@pytest.mark.room("page")
def test_study_has_as_many_scores_as_its_header_says(
    whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where header, study.json and all hashes agree on ten digits, and nothing is replayed."""
    name = next(name for name in whole if name.endswith("study.json"))
    scores = name.replace("study.json", "scores.jsonl")
    header, *rows = (
        {key: value for key, value in json.loads(line).items() if key not in {"previous", "hash"}}
        for line in whole[scores].splitlines()
    )
    previous, text = GENESIS, ""
    for line in ({**header, "seeds": 10**9}, *rows):
        sealed_line, previous = seal(line, previous)
        text += f"{canonical(sealed_line)}\n"
    study = {**json.loads(whole[name]), "seeds": 10**9, "digest": previous}
    members = {**whole, scores: text.encode(), name: readable(study).encode()}
    bundle = resealed(members, tmp_path / "x.zip")
    for command in (["report", str(bundle), "-o", str(tmp_path / "page.html")], ["replay", str(bundle)]):
        assert main(command) == 1
        (said,) = [line for line in capsys.readouterr().err.splitlines() if "expected 2000000000 scores" in line]
        assert "got 8" in said
        assert "tacevo-" not in said  # the private directory


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "..", "", "a/b", "x" * 300, 5, None, "a\nb"])
def test_name_of_a_run_that_is_no_folders_is_refused(name: Any, whole: Members, refused: Refused) -> None:
    """It becomes that of a directory."""
    run = {**json.loads(whole["run/run.json"]), "name": name}
    refused({**whole, "run/run.json": json.dumps(run).encode()}, "run.json, name: expected ")


@pytest.mark.parametrize(
    ("name", "content"),
    few_of(
        ["run.json", "ledger.jsonl", "archive.json", "prompts.json", "timings.jsonl"],
        [b"", b"[]", b"{}", b"null", b"[" * 100_000, b"\xff", b'{"schema": 1, "name": "x"}'],
    ),
)
def test_nonsense_is_refused_without_a_traceback(
    name: str, content: bytes, whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Any file of a run may hold anything; costs that are not told are none that are wrong."""
    bundle = resealed({**whole, f"run/{name}": content + b"\n"}, tmp_path / "x.zip")
    assert main(["replay", str(bundle)]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith(("refused: ", "different: "))


@pytest.mark.parametrize(
    ("kind", "answer"),
    few_of(
        [kind for kind in KINDS if kind not in {"decisions", "models"}],
        [None, [], {}, "text", 5, [[1]], {"training": 1, "profile": 2, "rejection": 3}],
    ),
)
def test_answer_of_no_known_form_is_refused(
    answer: Any, kind: str, whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A store entry may hold anything under its question, with every checksum right."""
    entries = entries_of(whole)
    next(entry for entry in entries if entry["kind"] == kind)["answer"] = answer
    assert main(["replay", str(resealed(with_entries(whole, entries), tmp_path / "x.zip"))]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith(("refused: ", "different: "))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_interrupted_replay_leaves_nothing(number: signal.Signals, published: Path, tmp_path: Path) -> None:
    """A polite request to end and Ctrl-C, while the search is run again."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tacevo.cli.app", "replay", str(published / "run.zip")],
        env={**os.environ, "TMPDIR": str(tmp_path / "temporary")},
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stderr is not None
    assert any(line.startswith(b"generation 0") for line in process.stderr)
    process.send_signal(number)
    assert process.wait() == 128 + number
    process.communicate()
    assert list((tmp_path / "temporary").iterdir()) == []
