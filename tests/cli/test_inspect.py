"""Promise: `tacevo show` and `tacevo check` say of any candidate what was asked and what came of it."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from fakes import TASK
from gate_cases import VALID, fenced
from ledger_lines import candidate, ended, header, rejected, run_record, trained
from refusals import refused

from tacevo.choices import Numerics
from tacevo.cli.app import main
from tacevo.cli.inspect import _sandbox
from tacevo.cli.show import show_run
from tacevo.config.conf_folder import conf_root
from tacevo.errors import RunError, SandboxError
from tacevo.evolution.lines import RepairedAnswer
from tacevo.records import Given, Operator, Reason, Stage, to_json
from tacevo.reproduce.bits.compare import Compared
from tacevo.runs.answers import task_without_data
from tacevo.storage.ledger import sealed_text
from tacevo.storage.run_directory import RunDirectory

SENT_BACK = RepairedAnswer(answer="b", stage=Stage.policy, reason=Reason.forbidden_import)

#: A search of every operator.
LINES = (
    trained("g00s00", 0.5),
    trained("g00s01", 0.25, operator=Operator.given, prompt=None, request=None, temperature=None, answer=None),
    candidate("g00s02", operator=Operator.sample, parents=(), prompt=None, source="s"),
    ended(0),
    trained("g01s00", 0.3, dropped=("temperature",), repairs=(SENT_BACK,)),
    rejected("g01s01", "extract", "no_class", operator=Operator.crossover, parents=("g00s00", "g00s01"), prompt=None),
    ended(1),
)


@pytest.fixture
def shown(tmp_path: Path) -> Path:
    """Return the directory of such a search, which is not finished and has kept no file."""
    directory = RunDirectory(tmp_path / "run")
    directory.path.mkdir()
    given = (Given(name="theirs", source="class Net: pass"),)
    config = to_json(task_without_data("force", 32)[0])
    directory.write_run(replace(run_record(task=replace(TASK, given=given)), config=config))
    directory.write_text("ledger.jsonl", sealed_text([header(), *LINES])[0])
    return directory.path


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("g00s00", "Instruction: none; this is the task's baseline"),
        ("g00s01", "Instruction: none; this network was given, as theirs"),
        ("g00s02", "Instruction: Draw a network at random."),
        ("g00s02", "| parents | none"),
        ("g01s00", "Instruction: i1: Do thing 1."),
        ("g01s00", "not sent: the model refuses it (0.6 was planned)"),
        ("g01s00", "Answers that were sent back before this one: 1 (policy: forbidden_import)"),
        ("g01s01", "Instruction: Combine them."),
        ("g01s01", "Its file is missing."),
    ],
)
def test_candidate_is_shown(name: str, words: str, shown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever asked for it, and however it was answered."""
    assert main(["show", str(shown), name]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert words in told


def test_source_that_was_edited_is_marked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its hash is not the ledger's, if only by the ends of its lines; the true one is shown without a mark."""
    source = folder / "run" / "candidates" / "g00s00.py"
    for edit, is_marked in ((b"\n", False), (b"\r\n", True), (b"  \n", True)):
        kept = source.read_bytes()
        source.write_bytes(kept.replace(b"\n", edit))
        assert main(["show", "run", "g00s00"]) == 0
        said = capsys.readouterr().out
        assert ("EDITED" in said) == is_marked
        assert "class " in said
        source.write_bytes(kept)


def test_run_without_its_ledger_names_the_ledger(shown: Path) -> None:
    """And not the archive, whose elites are then unknown."""
    (shown / "ledger.jsonl").unlink()
    with refused(RunError, place="ledger.jsonl", expected="ledger", got="nothing", remedy="restore the file"):
        show_run(shown)


def test_setting_of_a_run_that_is_wrong_names_its_file(shown: Path) -> None:
    """As a replay does."""
    directory = RunDirectory(shown)
    config = to_json(task_without_data("force", 32)[0])
    directory.write_run(replace(directory.read_run(), config={**config, "seed": -1}))
    with refused(RunError, place="run.json", got="seed: expected an integer of at least 0; got -1"):
        show_run(shown)


@pytest.mark.slow
def test_half_an_emoji_of_a_recording_is_judged_as_from_a_server(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A server's answer has a question mark there when it is kept; so has a recording, in every field that is read."""
    baseline = task_without_data("force", 32)[1].baseline
    recording = json.dumps({"response": f"caf\ud83d ```python\n{baseline}```", "stop_reason": "end\udc00"})
    assert r"\ud83d" in recording
    for name, text in {"low.json": recording, "high.json": recording.replace(r"\ud83d", r"\uD83D")}.items():
        (place / name).write_text(text)
    (place / "asked.json").write_text(recording.replace(r"\ud83d", "?").replace(r"\udc00", "?"))
    (place / "deep.json").write_text('{"response": "\\ud83d", "x": ' + "[" * 10_000)
    assert main(["check", "low.json", "high.json", "asked.json", "--image-size", "32"]) == 0
    verdicts = {line.partition(": ")[2] for line in capsys.readouterr().out.splitlines()}
    assert len(verdicts) == 1
    assert verdicts.pop().startswith("admitted")
    assert main(["check", "deep.json", "--image-size", "32"]) == 2
    assert "deep.json: expected JSON" in capsys.readouterr().err


@pytest.mark.slow
def test_words_say_what_json_says(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line a file: a source in a recording that is admitted, and an answer that was cut off."""
    baseline = (conf_root() / "library" / "force" / "baseline.py").read_text()
    (place / "good.json").write_text(json.dumps({"source": baseline}))
    (place / "cut.json").write_text(json.dumps({"response": "class Image", "stop_reason": "max_tokens"}))
    assert main(["check", "good.json", "cut.json", "--image-size", "32"]) == 0
    good, cut = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"good.json: admitted, [\d,]+ parameters", good)
    assert cut.startswith("cut.json: rejected at extract: ")


def test_check_says_what_was_changed_and_knows_the_baseline(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A change that lets an answer pass is no secret, and a quoted baseline is not the answer."""
    baseline = (conf_root() / "library" / "force" / "baseline.py").read_text()
    small = VALID.replace("class", "@torch.compile\nclass", 1)
    (place / "answer.md").write_text(f"{fenced(small)}\n\nThe baseline was:\n\n{fenced(baseline)}\n")
    (place / "plain.py").write_text(VALID)
    assert main(["check", "answer.md", "plain.py", "--image-size", "32"]) == 0
    changed, plain = capsys.readouterr().out.splitlines()
    assert "torch.compile" in changed
    assert changed.partition(";")[0].removeprefix("answer.md") == plain.removeprefix("plain.py")
    assert main(["check", "answer.md", "plain.py", "--image-size", "32", "--json"]) == 0
    details = [json.loads(line)["detail"] for line in capsys.readouterr().out.splitlines()]
    assert "torch.compile" in details[0]
    assert details[1] is None


def test_doctor_names_a_directory_that_cannot_be_written(
    place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was removed while the shell stood in it; the other findings are there, and the report, too."""
    same = Compared(level=Numerics.portable, digests={}, status=0, last_line="")
    monkeypatch.setattr("tacevo.reproduce.bits.compare.compare", lambda: [same])  # takes ten seconds
    report = place.parent / "report.json"
    place.rmdir()
    assert main(["doctor", "--report", str(report)]) == 1
    told = capsys.readouterr().out
    assert "FAIL current directory: [Errno 2] No such file or directory" in told
    assert "ok   configs" in told
    for level, compared in json.loads(report.read_text())["levels"].items():
        assert f"  {level}: {compared['says']}\n" in told


def test_doctor_fails_where_bits_cannot_be_computed(
    place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All else is well; the screen shows what the process said, and the file that is sent shows its status alone."""
    died = Compared(level=Numerics.portable, digests={}, status=-4, last_line="lost in /home/someone")
    monkeypatch.setattr("tacevo.reproduce.bits.compare.compare", lambda: [died])
    assert main(["doctor", "--report", "report.json"]) == 1
    told = capsys.readouterr().out
    assert "FAIL" not in told
    assert "status -4: lost in /home/someone" in told
    text = (place / "report.json").read_text()
    assert "status -4" in text
    assert "someone" not in text


@pytest.mark.slow
def test_file_that_cannot_be_read_stops_no_other(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Missing, a directory, not UTF-8, not a recording: each has its entry, and the status says that one failed."""
    (place / "folder").mkdir()
    (place / "latin.txt").write_bytes(b"class Caf\xe9")
    (place / "x.json").write_bytes(b"{}")
    (place / "y.json").write_bytes(b"[]")
    (place / "good.py").write_text((conf_root() / "library" / "force" / "baseline.py").read_text())
    unreadable = ["absent", "folder", "latin.txt", "x.json", "y.json"]
    assert main(["check", *unreadable[:2], "good.py", *unreadable[2:], "--image-size", "32", "--json"]) == 2
    files = {entry["file"]: entry for entry in map(json.loads, capsys.readouterr().out.splitlines())}
    assert list(files) == ["absent", "folder", "good.py", "latin.txt", "x.json", "y.json"]
    assert files["good.py"]["verdict"] == "admitted"
    for name in unreadable:
        assert (files[name]["verdict"], files[name]["stage"], files[name]["parameters"]) == ("unreadable", None, None)
        assert files[name]["detail"].startswith(f"{name}: expected ")


def test_doctor_names_a_baseline_that_the_gate_rejects(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search would have nothing to begin with."""
    config, task = task_without_data("force", 32)
    wrong = replace(task, baseline=f"import os\n{task.baseline}")
    monkeypatch.setattr("tacevo.cli.inspect.task_without_data", lambda *_: (config, wrong))
    with refused(SandboxError, expected="the baseline of task force to be admitted", got="policy, forbidden_import"):
        _sandbox(lambda _: None)
