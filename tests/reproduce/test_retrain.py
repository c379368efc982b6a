"""Promise: training again is compared with the record bit by bit, and the first bit that differs is named."""

import io
import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bundles import members_of, resealed
from commands import publish
from hand_runs import of_lines
from ledger_lines import header, rejected, run_record, trained
from refusals import refused
from rich.console import Console
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED

from tacevo.bundles.open import Opened, check_walls, opened
from tacevo.choices import Device, Numerics
from tacevo.cli import reproduce as commands
from tacevo.cli.app import main
from tacevo.errors import BundleError, DataError, DivergenceError
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.run_files import read_ledger
from tacevo.records import Reason, Rejection, Stage, Training
from tacevo.reproduce.retrain import (
    _check_equal,
    describe,
    difference,
    doubts_of,
    evaluations,
    retrain,
    sampled,
)
from tacevo.results.run import RecordedRun, read_run
from tacevo.runs.progress import Progress
from tacevo.storage.ledger import sealed_text
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Store

LINE = trained("g00s01", 0.3, train_losses=(0.5, 0.25), validation_losses=(0.6, 0.3))
TRAINING = Training(train_losses=(0.5, 0.25), validation_losses=(0.6, 0.3), predictions_sha256="p", weights_sha256="w")
REJECTION = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="nan")


def rewritten(folder: Path, change: Callable[[CandidateLine], CandidateLine]) -> None:
    """Change the candidates' lines of a run, with sound hashes and digest."""
    directory = RunDirectory(folder / "run")
    lines = [change(line) if isinstance(line, CandidateLine) else line for line in read_ledger(directory).lines]
    text, digest = sealed_text(lines)
    directory.write_text("ledger.jsonl", text)
    directory.write_run(replace(directory.read_run(), digest=digest))


def again(count: int | None = None) -> str:
    """Train again in the working directory."""
    with Progress(Console(quiet=True)) as view:
        return retrain([read_run(Path("run"))], count, 1, view)


def test_every_evaluation_comes_again_bit_for_bit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command says what it compared, and still ends with the digest; the store of evaluations stays as it was."""
    entries = {path: path.read_bytes() for path in (folder / "cache" / "evaluations").rglob("*.json")}
    assert main(["replay", "run", "--retrain"]) == 0
    output = capsys.readouterr()
    count = len(entries)
    assert f"retrained: {count} of {count} evaluations" in output.out
    assert (
        f"trained: {count}; train_losses, validation_losses, predictions, weights are bit for bit as recorded"
        in output.out
    )
    assert "as recorded (1 of " in output.err
    assert output.out.splitlines()[-1].startswith("digest: ")
    assert {path: path.read_bytes() for path in (folder / "cache" / "evaluations").rglob("*.json")} == entries


def test_changed_record_is_found(folder: Path) -> None:
    """One other digest of weights in a ledger that is sound otherwise is named with the candidate and both values."""
    rewritten(folder, lambda line: replace(line, weights="0" * 64) if line.id == "g00s01" else line)
    with refused(DivergenceError, place="g00s01", got=f"weights: recorded {'0' * 64}, recomputed "):
        again()


@pytest.mark.slow
def test_changed_trivial_loss_is_found(folder: Path) -> None:
    """It follows from the validation labels, which a replay does not have; without one the rest is compared."""
    directory = RunDirectory(folder / "run")
    run = directory.read_run()
    directory.write_run(replace(run, trivial=None))
    assert "bit for bit as recorded" in again(1)
    directory.write_run(replace(run, trivial=99.0))
    with refused(DivergenceError, place="run.json, trivial", got="99.0", expected=f"{run.trivial}, by the validation"):
        again(1)


@pytest.mark.slow
def test_record_without_digests_is_compared_as_far_as_it_goes(folder: Path) -> None:
    """What an older run does not record is said, and the rest is compared; what it ran on is doubted."""
    rewritten(folder, lambda line: replace(line, weights=None, predictions=None))
    directory = RunDirectory(folder / "run")
    directory.write_run(replace(run := directory.read_run(), versions={**run.versions, "torch": "0"}))
    with Progress(Console(file=(told := io.StringIO()), width=500)) as view:
        said = retrain([read_run(Path("run"))], None, 1, view)
    assert told.getvalue().count("equal bits are not promised: torch is ") == 1
    assert "train_losses, validation_losses are bit for bit as recorded" in said
    assert "not recorded, hence not compared: predictions, weights" in said


def test_another_data_set_is_refused_before_anything_is_trained(folder: Path) -> None:
    """Its fingerprint is compared first, and the message has both."""
    path = folder / "run" / "run.json"
    run = json.loads(path.read_text())
    run["config"]["data"]["seed"] += 1
    path.write_text(json.dumps(run))
    with refused(DataError, got="one with the fingerprint", expected="the run's data set", remedy="restore"):
        again()


def test_run_without_its_versions_is_damaged(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where run.json does not say what the run was computed with, that is one line, and nothing is trained."""
    path = folder / "run" / "run.json"
    run = json.loads(path.read_text())
    del run["versions"]
    path.write_text(json.dumps(run))
    assert main(["replay", "run", "--retrain"]) == 2
    output = capsys.readouterr()
    assert "run.json, versions: expected a value" in output.err
    assert "as recorded (1 of" not in output.err


OLDER = replace(LINE, predictions=None, weights=None)

FAILED = rejected("g00s02", "train", "not_finite")


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            [LINE, OLDER, FAILED],
            [
                "retrained: 3 of 9 evaluations",
                "trained: 2; train_losses, validation_losses are bit for bit as recorded",
                "rejected: 1, for the recorded reasons",
                "not recorded, hence not compared: predictions, weights",
            ],
        ),
        ([], ["retrained: 0 of 9 evaluations"]),
        ([FAILED] * 4, ["retrained: 4 of 9 evaluations", "rejected: 4, for the recorded reasons"]),
    ],
)
def test_nothing_is_called_equal_that_was_not_compared(lines: list[CandidateLine], said: list[str]) -> None:
    """Losses and digests are spoken of where something trained, reasons where something was rejected."""
    assert describe(lines, 9, "").splitlines() == said


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"train_losses": (0.5, 0.2500001)}, "train_losses of epoch 2: recorded 0.2500001, recomputed 0.25"),
        ({"validation_losses": (0.7, 0.3)}, "validation_losses of epoch 1: recorded 0.7, recomputed 0.6"),
        ({"validation_losses": (0.6,)}, "validation_losses: recorded (0.6,), recomputed (0.6, 0.3)"),
        ({"predictions": "q"}, "predictions: recorded q, recomputed p"),
        ({"weights": "v"}, "weights: recorded v, recomputed w"),
        ({"stage": Stage.train, "reason": Reason.not_finite}, "the outcome: recorded not_finite, recomputed trained"),
    ],
)
def test_first_difference_is_named(change: dict[str, Any], named: str) -> None:
    """Each field is compared, the epochs of losses one by one."""
    assert difference(LINE, TRAINING) is None
    assert difference(replace(LINE, **change), TRAINING) == named


def test_rejections_are_compared_by_reason() -> None:
    """A training that failed must fail again, for the same reason."""
    assert difference(FAILED, REJECTION) is None
    assert difference(LINE, REJECTION) == "the outcome: recorded trained, recomputed not_finite"


@pytest.mark.parametrize(
    ("line", "result", "doubts", "remedy"),
    [
        (replace(LINE, weights="v"), TRAINING, ("torch is 3; the run had 2",), "not promised: torch is 3"),
        (LINE, replace(REJECTION, reason=Reason.out_of_time), (), "try with executor.workers=1 or a quiet machine"),
        (replace(LINE, weights="v", not_portable=("tanh",)), TRAINING, (), "tanh, whose bits depend on the CPU"),
        (LINE, REJECTION, (), ""),
    ],
)
def test_difference_comes_with_what_explains_it(
    line: CandidateLine, result: Training | Rejection, doubts: tuple[str, ...], remedy: str
) -> None:
    """Other versions, a slow machine, or what the candidate calls; nothing is made up where none of them is known."""
    with refused(DivergenceError, place="job, g00s01", remedy=remedy):
        _check_equal("job, ", line, result, doubts)


def test_outcomes_of_the_machine_are_left_out_and_equal_sources_count_once() -> None:
    """Running out of time is not a property of a candidate; an evaluation that two candidates share is one."""
    slow = rejected("g00s02", "train", "out_of_time", evaluation="f")
    untrained = rejected("g00s03", "probe", "crashed")
    run = of_lines(header(), LINE, replace(LINE, id="g00s04"), slow, untrained)
    assert evaluations([run, run]) == [(run, LINE)]


def forge(folder: Path, candidate: str, factor: float) -> None:
    """Multiply the losses of a candidate's recorded evaluation, and search again with them, into `forged/run`."""
    key = next(line.evaluation for line in read_run(Path("run")).candidates if line.id == candidate)
    store = Store(folder / "cache", "evaluations")
    entry = next(entry for entry in store.entries() if entry.key == key)
    answer: Any = entry.answer
    for losses in ("train_losses", "validation_losses"):
        answer["training"][losses] = [float(f"{factor * loss:.9g}") for loss in answer["training"][losses]]
    store.write(entry.request, answer)
    where = ["run.dir=forged/run", "store.root=cache"]
    assert main(["search", *SMALLEST, UNTRACKED, *PUBLISHED_SIZES, *where]) == 0


def drawn_by_the_runs_own_seed(run: RecordedRun) -> set[str]:
    """Return the candidate that would be trained by a draw that its maker knows."""
    lines = {line.evaluation: line.id for _, line in evaluations([run])}
    return {lines[key] for key in sampled(list(lines), 1, run.config.seed)}


def test_forged_best_network_is_always_found(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where the bundle's own seed, which earlier releases drew by, does not draw it."""
    run = read_run(Path("run"))
    old = drawn_by_the_runs_own_seed(run)
    candidate = next(line.id for line in run.candidates if line.generation == 0 and line.id not in old)
    forge(folder, candidate, 0.3)
    run = read_run(Path("forged/run"))
    assert candidate not in drawn_by_the_runs_own_seed(run)
    publish("forged/run", "-o", "forged.zip")
    assert main(["replay", "forged.zip"]) == 0  # its records fit each other
    assert main(["replay", "forged.zip", "--retrain", "1"]) == 1
    assert f"different: {candidate}: train_losses of epoch 1: recorded " in capsys.readouterr().err


@pytest.mark.slow
def test_forged_network_of_a_study_is_always_found(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Here the baseline, which is made worse than it is, so that the best looks better beside it."""
    forge(folder, "g00s00", 1.5)
    assert main(["study", "run=forged/run", "elites=1", "seeds=4", "epochs=1"]) == 0
    capsys.readouterr()
    assert main(["replay", "forged/run", "--retrain", "1"]) == 1
    assert "different: g00s00: train_losses of epoch 1: recorded " in capsys.readouterr().err


@pytest.mark.slow
def test_draw_is_the_readers_own_and_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is said before anything is trained and in the end, with the odds; the same number draws the same again."""
    seeds: list[str] = []
    drawn: list[list[str]] = []
    for given in ([], ["--draw"]):
        assert main(["replay", "run", "--retrain", "1", *given, *seeds]) == 0
        said = capsys.readouterr()
        told = [re.findall(r"1 of the other 3, .*--draw (\d+) .* with a chance of 33.3 %", text) for text in said]
        assert told[0] == told[1] != []
        seeds += told[0]
        drawn.append(re.findall(r"^(g\d+s\d+): as recorded", said.err, re.MULTILINE))
    assert seeds[0] == seeds[1]
    assert drawn[0] == drawn[1]
    assert {"g00s00", "g01s02"} < set(drawn[0])  # the baseline of its study, and the best


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--retrain=0"], "expected an integer of at least 1"),
        (["--retrain=-1"], "expected an integer of at least 1"),
        (["--retrain=two"], "expected an integer of at least 1"),
        (["--draw", "7"], "--draw repeats the draw of --retrain N"),
        (["--retrain", "--draw", "7"], "--draw repeats the draw of --retrain N"),
    ],
)
def test_options_that_would_be_without_effect_are_refused(
    options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the run is read."""
    monkeypatch.chdir(tmp_path)
    Path("run").mkdir()
    assert main(["replay", "run", *options]) == 2
    assert words in capsys.readouterr().err


def test_every_evaluation_can_be_drawn_and_a_seed_repeats_a_draw() -> None:
    """As often as the odds say, none twice, in their order: none is out of reach, as where its maker knew the seed."""
    keys = [str(number) for number in range(170)]
    drawn = sampled(keys, 10, 0)
    assert drawn == [key for key in keys if key in drawn]
    assert len(drawn) == 10
    assert sampled(keys, 10, 0) == drawn != sampled(keys, 10, 1)
    counts = Counter(key for seed in range(2000) for key in sampled(keys, 5, seed))
    assert set(counts) == set(keys)
    assert min(counts.values()) > 2000 * 5 / 170 / 2


def test_two_replays_draw_by_two_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the machine's own randomness, whatever the records hold."""
    seeds: list[int] = []

    def note(runs: object, count: int, draw: int, view: Progress) -> str:
        seeds.append(draw)
        return ""

    monkeypatch.setattr(commands, "retrain", note)
    for draw in (None, None, 7):
        commands._retrain([], None, 5, draw, Progress(Console(quiet=True)))
    assert seeds[0] != seeds[1]
    assert seeds[2] == 7


def test_only_what_was_promised_is_not_doubted() -> None:
    """Another library leaves every promise; another CPU that of `fast`, another GPU that of `cuda`."""
    versions, machine = {"torch": "2", "numpy": "2"}, {"cpu": "A", "architecture": "x86_64", "gpu": "H"}
    run = run_record(versions=versions, machine=machine)
    other, moved = {**machine, "cpu": "B"}, {**machine, "gpu": None}
    cpu, cuda = Device.cpu, Device.cuda
    assert doubts_of(run, Numerics.fast, cpu, versions, machine) == ()
    assert doubts_of(run, Numerics.portable, cpu, versions, other) == ()
    assert doubts_of(run, Numerics.fast, cpu, versions, other) == ("cpu is B; the run had A",)
    assert doubts_of(run, Numerics.fast, cpu, versions, moved) == ()
    assert doubts_of(run, Numerics.fast, cuda, versions, moved) == ("gpu is None; the run had H",)
    for numerics in Numerics:
        assert doubts_of(run, numerics, cpu, {**versions, "torch": "3"}, machine) == ("torch is 3; the run had 2",)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("sandbox.require=none", "sandbox.require=none"),
        ("training.device=cuda", "training.device=cuda"),
        ("sandbox.require=Confinement.none", "sandbox.require: expected 'none'"),
        ("training.device=Device.cuda", "training.device: expected 'cpu'"),
    ],
)
def test_bundle_does_not_take_the_walls_down(
    setting: str, words: str, published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its candidates run behind walls or not at all; a directory is its owner's own."""
    members = members_of(published / "run.zip")
    run = json.loads(members["run/run.json"])
    key, _, value = setting.partition("=")
    group, _, name = key.partition(".")
    run["config"][group][name] = value
    bundle = resealed({**members, "run/run.json": json.dumps(run).encode()}, tmp_path / "x.zip")
    place = opened(bundle)
    with pytest.raises(BundleError, match=words):
        check_walls(place)
    for command in (["replay", str(bundle), "--retrain"], ["extend", str(bundle), "search.generations=9"]):
        assert main(command) == 1
        assert words in capsys.readouterr().err
    check_walls(Opened(folder=place.folder, entries=place.store))
