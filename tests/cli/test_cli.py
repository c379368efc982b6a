"""The command as a user gives it: searching, stopping, continuing, replaying, and every mistake in one line."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from commands import tacevo
from smallest import Once

from tacevo.cli.app import COMMANDS, main

COMMAND = [sys.executable, "-m", "tacevo.cli.app"]

#: A real search, as small as one can be that still mutates and crosses over.
TINY = [
    "experiment=demo",
    "tracking=none",
    "search.generations=2",
    "search.candidates=3",
    "search.initial=2",
    "data.images=60",
    "training.epochs=1",
    "archive.niches=10",
    "archive.prompt_niches=10",
    "archive.samples=200",
    "proposals.mutation_probability=0.5",
    "seed=4",
]

#: What may stand in a line of the ledger, by kind of line.
SEALED = {"kind", "previous", "hash"}
ASKED = SEALED | {"generation", "slot", "id", "operator", "parents", "prompt", "request", "temperature", "answer"}
TRAINED = ASKED | {
    "source", "evaluation", "weights", "predictions", "train_losses", "validation_losses", "fitness", "parameters",
    "flops", "arch_div", "eff_ratio", "entropy", "density", "variation", "niche", "status", "curiosity"
}  # fmt: skip
KEYS = {
    "run": SEALED | {"schema", "config", "task", "data", "centroids", "rules"},
    "trained": TRAINED,
    "trained with a recorded prompt": TRAINED | {"prompt_niche", "prompt_status"},
    "rejected": ASKED | {"stage", "reason"},
    "generation": SEALED
    | {
        "generation", "candidates", "trained", "best", "generation_best", "generation_median", "coverage", "qd_score",
        "prompt_coverage", "temperature", "next_temperature", "bounds", "archive", "prompt_archive"
    },
}  # fmt: skip
CONFIG_KEYS = {
    "seed", "archive", "temperature", "prompts", "proposals", "training", "gate", "search", "llm", "numerics"
}  # fmt: skip


def kind_of(line: dict[str, Any]) -> str:
    """Name the kind of a ledger line; a mutation's prompt is recorded from generation 1 on."""
    if line["kind"] != "candidate":
        return str(line["kind"])
    if "stage" in line:
        return "rejected"
    prompted = line["operator"] == "mutation" and line["generation"] > 0
    return "trained with a recorded prompt" if prompted else "trained"


def digest(done: subprocess.CompletedProcess[str]) -> str:
    """Take the digest from the last line of a command's output."""
    *_, last = done.stdout.splitlines()
    name, _, value = last.partition(": ")
    assert name == "digest"
    assert len(value) == 64
    return value


def run_of(folder: Path) -> Path:
    """Find the one run directory below a folder."""
    (run,) = (folder / "runs").iterdir()
    return run


def evaluations(folder: Path) -> list[Path]:
    """List the entries of the evaluation store."""
    return sorted((folder / "cache" / "evaluations").glob("*/*.json"))


@pytest.fixture(scope="session")
def searched(once: Once) -> tuple[Path, str]:
    """Return the directory and the digest of one finished tiny search."""
    folder = once("searched", lambda folder: tacevo("search", *TINY, cwd=folder))
    return folder, json.loads((run_of(folder) / "run.json").read_text())["digest"]


@pytest.fixture
def copied(searched: tuple[Path, str], tmp_path: Path) -> Path:
    """Give a copy of the finished search, to be spoilt."""
    shutil.copytree(searched[0], tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_run_directory_can_be_read_with_ls_and_cat(searched: tuple[Path, str]) -> None:
    """Everything that the README names is there, and run.json knows the digest."""
    run = run_of(searched[0])
    names = {path.name for path in run.iterdir() if not path.name.startswith(".")}
    assert names == {
        "run.json", "ledger.jsonl", "timings.jsonl", "archive.json", "prompts.json", "candidates", "summary.md"
    }  # fmt: skip
    assert json.loads((run / "run.json").read_text())["digest"] == searched[1]
    assert (run / "candidates" / "g00s00.py").read_text().count("class ImageRegressionCNN") == 1
    assert not list(searched[0].rglob("*.part"))


def test_ledger_holds_no_time_path_or_host(searched: tuple[Path, str]) -> None:
    """What differs between machines stays out of what is hashed: every line has the keys of its kind and no others."""
    text = (run_of(searched[0]) / "ledger.jsonl").read_text()
    assert str(searched[0]) not in text
    assert os.uname().nodename not in text
    lines = [json.loads(line) for line in text.splitlines()]
    assert {kind_of(line) for line in lines} == set(KEYS)
    for line in lines:
        assert set(line) == KEYS[kind_of(line)]
    assert set(lines[0]["config"]) == CONFIG_KEYS


def test_same_command_again_trains_nothing_and_gives_the_same_digest(searched: tuple[Path, str]) -> None:
    """A finished search is answered from the stores."""
    before = {path: path.stat().st_mtime_ns for path in evaluations(searched[0])}
    again = tacevo("search", *TINY, cwd=searched[0])
    assert digest(again) == searched[1]
    assert {path: path.stat().st_mtime_ns for path in evaluations(searched[0])} == before


def test_search_that_replays_says_that_it_cost_nothing(searched: tuple[Path, str]) -> None:
    """What the recordings cost stands in the summary, so the command says that it was not paid again."""
    said = "this search made no call and cost nothing"
    again = tacevo("search", *TINY, "llm.mode=replay", cwd=searched[0])
    assert (digest(again), said in again.stdout) == (searched[1], True)
    assert said not in tacevo("search", *TINY, cwd=searched[0]).stdout


def test_replay_needs_neither_data_nor_sandbox_and_gives_the_digest(copied: Path, searched: tuple[Path, str]) -> None:
    """A recorded search is run again from its stores alone."""
    shutil.rmtree(copied / "cache" / "data")
    assert digest(tacevo("replay", str(run_of(copied)), cwd=copied)) == searched[1]


def test_interrupted_search_says_so_and_continues(searched: tuple[Path, str], tmp_path: Path) -> None:
    """Ctrl-C ends with status 130 and one line, and costs nothing."""
    search = subprocess.Popen([*COMMAND, "search", *TINY], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not evaluations(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.1)
    search.send_signal(signal.SIGINT)
    _, errors = search.communicate(timeout=60)
    assert search.returncode == 130
    assert "the same command continues" in errors
    assert "Traceback" not in errors
    assert not processes_in(tmp_path)
    assert "Not finished" in tacevo("show", str(run_of(tmp_path)), cwd=tmp_path).stdout
    assert "is not finished" in tacevo("replay", str(run_of(tmp_path)), cwd=tmp_path, status=2).stderr
    assert digest(tacevo("search", *TINY, cwd=tmp_path)) == searched[1]


def processes_in(folder: Path) -> list[str]:
    """List the processes that stand in a folder, after a moment for the dying."""
    deadline = time.monotonic() + 20
    while True:
        alive = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if (process / "cwd").readlink() == folder.resolve():
                    alive.append((process / "cmdline").read_text())
            except OSError:
                continue
        if not alive or time.monotonic() > deadline:
            return alive
        time.sleep(0.2)


@pytest.mark.slow
def test_longer_search_continues_a_shorter_one(copied: Path) -> None:
    """More generations in the same directory append to its ledger; fewer are refused."""
    run = run_of(copied)
    before = (run / "ledger.jsonl").read_text()
    tacevo("search", *TINY, "search.generations=3", f"run.dir={run}", cwd=copied)
    assert (run / "ledger.jsonl").read_text().startswith(before)
    refused = tacevo("search", *TINY, "search.generations=1", f"run.dir={run}", cwd=copied, status=2)
    assert "got a longer run" in refused.stderr


def test_other_configuration_in_the_same_directory_is_refused(copied: Path) -> None:
    """One directory holds one run, and nothing of it is overwritten."""
    run = run_of(copied)
    before = (run / "ledger.jsonl").read_bytes()
    refused = tacevo("search", *TINY, "seed=3", f"run.dir={run}", cwd=copied, status=2)
    assert "got another run" in refused.stderr
    assert (run / "ledger.jsonl").read_bytes() == before


def test_show_tells_a_run_and_a_candidate(searched: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    """The summary, and one candidate with its instruction, numbers, losses and source."""
    run = str(run_of(searched[0]))
    assert main(["show", run]) == 0
    assert "## Gate" in capsys.readouterr().out
    assert main(["show", run, "g00s00"]) == 0
    shown = capsys.readouterr().out
    assert "this is the task's baseline" in shown
    assert "class ImageRegressionCNN" in shown
    assert main(["show", run, "g99s00"]) == 2
    assert "got 'g99s00'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["search", "archive.nichs=3"], "archive.nichs: not a setting; did you mean archive.niches?"),
        (["search", "seed=abc"], 'seed: expected an integer; got "abc"'),
        (["search", "archive.niches=0"], "archive.niches: expected"),
        (["search", "task=forse"], "one of force, grating, hardness"),
        (["search", "experiment=demo", "data=folder", "data.root=nowhere"], "nowhere"),
        (["replay", "nowhere"], "nowhere: it does not exist"),
        (["show", "nowhere"], "nowhere: expected the directory of a run"),
        (["check", "nowhere.py"], "nowhere.py: No such file or directory"),
    ],
)
def test_users_mistake_is_one_line_and_status_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """No traceback for a user's mistake, and nothing is left behind by it."""
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "runs").exists()


def test_help_is_complete_without_any_library() -> None:
    """Help lists every command, and imports nothing that would make it slow."""
    script = (
        "import sys, contextlib\nfrom tacevo.cli.app import main\n"
        "with contextlib.suppress(SystemExit): main(['--help'])\n"
        "print('slow:', sorted({'numpy', 'pydantic', 'torch', 'hydra', 'mlflow', 'rich'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert "slow: []" in out
    for command in COMMANDS:
        assert re.search(rf"^    {command}\b", out, re.MULTILINE)


def test_search_help_lists_the_groups() -> None:
    """The choices of every config group can be read without opening a file."""
    out = subprocess.run([*COMMAND, "search", "--help"], capture_output=True, text=True, check=True).stdout
    assert re.search(r"^  task +force, grating, hardness$", out, re.MULTILINE)


def test_check_judges_raw_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One JSON object a line, with the fields that other tools rely on."""
    monkeypatch.chdir(tmp_path)
    network = "class ImageRegressionCNN(nn.Module):\n    def __init__(self, num_outputs=3):\n"
    network += "        super().__init__()\n        self.fc = nn.Linear(3 * 32 * 32, num_outputs)\n\n"
    network += "    def forward(self, x):\n        return self.fc(x.flatten(1))\n"
    Path("good.txt").write_text(f"Here it is:\n\n```python\n{network}```\n")
    Path("bad.txt").write_text("I cannot do that.")
    assert main(["check", "good.txt", "bad.txt", "--task", "force", "--image-size", "32", "--json"]) == 0
    good, bad = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (good["file"], good["verdict"], good["parameters"]) == ("good.txt", "admitted", 3 * 32 * 32 * 3 + 3)
    assert (bad["verdict"], bad["stage"], bad["reason"]) == ("rejected", "extract", "no_class")


def test_doctor_finds_this_machine_sound(tmp_path: Path) -> None:
    """Machine, versions, confinement, and checks that really try."""
    out = tacevo("doctor", cwd=tmp_path).stdout
    assert "ok   sandbox" in out
    assert "FAIL" not in out


@pytest.mark.parametrize("number", [pytest.param(signal.SIGKILL, marks=pytest.mark.slow), signal.SIGINT])
def test_stop_while_images_are_made_leaves_no_process(number: signal.Signals, tmp_path: Path) -> None:
    """The processes that make images end with the search, killed or interrupted."""
    many = ["experiment=demo", "tracking=none", "data.images=20000", "data.image_size=64"]
    search = subprocess.Popen(
        [*COMMAND, "search", *many], cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while kilobytes_of_images(tmp_path) < 200 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert search.poll() is None
    if number is signal.SIGKILL:
        search.kill()
    else:
        os.killpg(search.pid, number)  # as a terminal does
    _, errors = search.communicate(timeout=60)
    assert search.returncode == (-signal.SIGKILL if number is signal.SIGKILL else 130)
    assert number is signal.SIGKILL or "Traceback" not in errors
    assert not processes_in(tmp_path)


def kilobytes_of_images(folder: Path) -> int:
    """Measure what is written of the images that are being made; the file is sparse until then."""
    files = (folder / "cache" / "data").glob(".*/images.npy")
    return sum(file.stat().st_blocks // 2 for file in files)


def test_archive_that_names_a_stranger_is_one_line(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`show` reads an unfinished run, too, so it compares ids only; the message names the file."""
    shutil.copytree(published / "run", tmp_path / "run")
    path = tmp_path / "run" / "archive.json"
    archive = json.loads(path.read_text())
    archive["elites"][0]["id"] = "zzz"
    path.write_text(json.dumps(archive))
    assert main(["show", str(tmp_path / "run")]) == 2
    assert f"{path}: expected trained candidates of the ledger; got zzz" in capsys.readouterr().err
