"""The command as a user gives it: searching, stopping, continuing, replaying, and every mistake in one line."""

import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from interruptions import SEARCH, ends, processes_of
from refusals import refused
from smallest import DRAWN, UNTRACKED
from waiting import eventually

from tacevo.cli.app import main
from tacevo.cli.commands import OURS
from tacevo.cli.common import output_directory
from tacevo.cli.search import print_end
from tacevo.cli.signature import WIDTH
from tacevo.config.compose import compose
from tacevo.config.plain import from_plain
from tacevo.config.schema import keys
from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.runs.session import Result

COMMAND = [sys.executable, "-m", "tacevo.cli.app"]

#: The search of `whole_search`.
TINY = ["search", *SEARCH, UNTRACKED]


def evaluations(folder: Path) -> dict[Path, int]:
    """List the entries of the evaluation store, with the times of their last change in ns."""
    return {path: path.stat().st_mtime_ns for path in (folder / "cache" / "evaluations").glob("*/*.json")}


def test_run_directory_can_be_read_with_ls_and_cat(whole_search: tuple[Path, str]) -> None:
    """Everything that the README names is there, and the ledger's last hash is the digest."""
    run = whole_search[0] / "run"
    names = {path.name for path in run.iterdir() if not path.name.startswith(".")}
    assert names == {
        "run.json", "ledger.jsonl", "timings.jsonl", "archive.json", "prompts.json", "candidates", "summary.md"
    }  # fmt: skip
    assert json.loads((run / "ledger.jsonl").read_text().splitlines()[-1])["hash"] == whole_search[1]
    assert (run / "candidates" / "g00s00.py").read_text().count("class ImageRegressionCNN") == 1
    assert not list(whole_search[0].rglob("*.part"))


def test_ledger_holds_no_time_path_or_host(whole_search: tuple[Path, str]) -> None:
    """What differs between machines stays out of what is hashed; the keys of a line are those of its record."""
    text = (whole_search[0] / "run" / "ledger.jsonl").read_text()
    assert str(whole_search[0]) not in text
    assert os.uname().nodename not in text
    assert not re.search(r"\d\d:\d\d:\d\d", text)


def test_same_command_again_trains_nothing_and_gives_the_same_digest(
    copied: Path, whole_search: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A finished search is answered from the stores; where it must be, it says that nothing was paid again."""
    before, said = evaluations(copied), "this search made no call and cost nothing"
    for mode, free in (("record", False), ("replay", True)):
        assert main([*TINY, f"llm.mode={mode}"]) == 0
        out, progress = capsys.readouterr()
        assert "finished before; nothing to do" in progress
        assert "generation 0" not in progress  # nothing was trained
        assert out.splitlines()[-1] == f"digest: {whole_search[1]}"
        assert (said in out) == free
        assert sum(max(1, math.ceil(len(line) / 80)) for line in out.splitlines()) <= 25
    assert evaluations(copied) == before


def test_interrupted_search_says_so_and_continues(
    whole_search: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C ends with status 130 and one line, and costs nothing."""
    search = subprocess.Popen([*COMMAND, *TINY], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert eventually(lambda: bool(evaluations(tmp_path)), seconds=120)
    search.send_signal(signal.SIGINT)
    _, errors = search.communicate(timeout=60)
    assert search.returncode == 130
    assert "and the same command continues" in errors.splitlines()[-1]
    assert "Traceback" not in errors
    assert ends(tmp_path), processes_of(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["show", "run"]) == 0
    assert "Not finished" in capsys.readouterr().out
    assert main(["replay", "run"]) == 2
    assert "is not finished" in capsys.readouterr().err
    shutil.copytree(whole_search[0] / "cache", "cache", dirs_exist_ok=True)  # so that the rest takes no time
    assert main(TINY) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"digest: {whole_search[1]}"


@pytest.mark.slow
def test_longer_search_continues_a_shorter_one(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """More generations in the same directory append to its ledger; fewer are refused."""
    before = (copied / "run" / "ledger.jsonl").read_text()
    assert main([*TINY, "search.generations=3"]) == 0
    assert (copied / "run" / "ledger.jsonl").read_text().startswith(before)
    assert main([*TINY, "search.generations=1"]) == 2
    assert "got a longer run" in capsys.readouterr().err


def test_other_configuration_in_the_same_directory_is_refused(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One directory holds one run, and nothing of it is overwritten."""
    before = (copied / "run" / "ledger.jsonl").read_bytes()
    assert main([*TINY, "seed=3"]) == 2
    assert "got another run" in capsys.readouterr().err
    assert (copied / "run" / "ledger.jsonl").read_bytes() == before


@pytest.mark.room("noise")
def test_end_of_a_search_names_what_can_be_typed(capsys: pytest.CaptureFixture[str]) -> None:
    """Where to look and what next, also where a directory has a space in its name; the digest is the last line."""
    result = Result(
        directory=Path("my runs/one"), digest="d", summary="found\n", best="g01s02", succeeded=True, looked_up=False
    )
    print_end(result, ["a remark"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["found", ""]
    assert lines[2] == "read:   my runs/one/summary.md (cite the digest of the search, below)"
    assert [shlex.split(line)[2:] for line in (lines[3], lines[4], lines[6])] == [
        *(["show", "my runs/one", "g01s02"], ["replay", "my runs/one"]),
        ["noise", "my runs/one", "elites=2", "seeds=12"],
    ]
    assert (lines[5], lines[7:]) == ("a remark", ["digest: d"])
    print_end(replace(result, succeeded=False))  # nothing was found that could be trained again
    assert "noise" not in capsys.readouterr().out


def test_show_tells_a_run_and_a_candidate(whole_search: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    """The summary, and one candidate with its instruction, numbers, losses and source."""
    run = str(whole_search[0] / "run")
    assert main(["show", run]) == 0
    assert "## Generations" in capsys.readouterr().out
    assert main(["show", run, "g00s00"]) == 0
    shown = capsys.readouterr().out
    assert "this is the task's baseline" in shown
    assert "class ImageRegressionCNN" in shown
    assert main(["show", run, "g99s00"]) == 2
    assert "got 'g99s00'" in capsys.readouterr().err
    assert main(["show", run, "best"]) == 2
    assert "expected the id of a candidate, such as g02s03" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["search", "archive.nichs=3"], "archive.nichs: not a setting; did you mean archive.niches?"),
        (["search", "seed=abc"], 'seed: expected an integer; got "abc"'),
        (["search", "archive.niches=0"], "archive.niches: expected"),
        (["search", "task=forse"], "one of force, grating, hardness, shape"),
        (["search", "experiment=demo", "data=folder", "data.root=nowhere", UNTRACKED, *DRAWN], "nowhere"),
        (
            ["replay", "nowhere"],
            "nowhere: expected the directory or bundle of a run or a sweep; got a path that does not exist",
        ),
        (["show", "nowhere"], "nowhere: expected the directory or bundle of a run"),
        (
            ["check", "nowhere.py"],
            "nowhere.py: expected the file of an answer: text in UTF-8; got one that cannot be read (No such file",
        ),
        (["search", "experiment=demmo"], "got demmo; did you mean demo?"),
        (["search", "experiment=demo", "llm=antropic"], "did you mean anthropic?"),
        (["search", "experiment=demo", "ablation=no_prompt_archiv"], "did you mean no_prompt_archive?"),
        (["search", "-m", "experiment=demo", "ablation=none,", "drift"], "no space after the comma or within brackets"),
        (["search", "-m", "experiment=demo", "ablation=none", ",drift"], "ablation=none,drift"),
        (["search", "experiment=demo", "search.networks=[a.py,", "b.py]"], "'search.networks=[a.py,b.py]'"),
        (["search", "experiment", "=", "demo"], "no space beside the equals sign"),
        (["search", "experiment=demo", "seed", "3"], "write seed=3"),
        (["search", "seed:3"], "write seed=3"),
        (["search", "demo"], "did you mean experiment=demo?"),
        (["search", "experiment=demo", "--seed", "3"], "a setting is written without dashes: seed=3"),
        (["search", "--experiment=demo"], "without dashes: experiment=demo"),
        (["search", "experiment=demo", "seed=0-3"], "a range is 'seed=range(0,4)'"),
        (["search", "-m", "experiment=demo", "seed=0..3"], "a range is 'seed=range(0,4)'"),
        (["show", ".", "g00s00", "--sorce"], "unrecognized arguments: --sorce; did you mean --source?"),
        (["report", ".", "--folow"], "did you mean --follow?"),
        (["search", "--into", "here"], "--into names the directory of a sweep, so it needs -m"),
        (["search", "seed=1"], "experiment: expected one of demo, "),
        (["search", "-m", "seed=1,2"], "experiment: expected one of demo, "),
        (["search", "experiment=demo", "seed=0,1"], "expected one value: this runs once; got seed=0,1"),
        (["search", "experiment=demo", "seed=range(0,2)"], "`tacevo search -m ...` runs a sweep of all values"),
        (["report", ".", "--latex", "--follow"], "does not go with --latex"),
        (["tables"], "name a run or a sweep, or give --paper"),
        (["study", "sweep=.", "data.split_seed=1"], "no setting of data with sweep=: jobs are compared on their own"),
    ],
)
def test_users_mistake_is_one_line_and_status_2(
    arguments: list[str],
    message: str,
    place: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """No traceback for a user's mistake, and nothing is left behind by it."""
    assert main(arguments) == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors
    assert not (place / "runs").exists()


#: Mistakes that are seen before anything is read, and the help.
QUICK = [
    *(
        f"{command} nowhere"
        for command in ("tables", "replay", "report", "show", "figures", "ablations", "publish -o a")
    ),
    *("noise nowhere", "study run=nowhere", "plan sweep nowhere --effect 0.1", "extend nowhere"),
    *("tables --wrong", "tables", "tables one/run.zip two/run.zip -o out", "figures one/run.zip", "replay . --draw 1"),
    *("report one/run.zip --latex --follow", "show one/run.zip/job", "--help"),
]


def test_help_is_complete_and_mistakes_are_answered_without_any_library(place: Path) -> None:
    """Help lists every command; neither it nor an error that needs no reading imports what would make it slow."""
    for folder in ("one", "two"):
        Path(folder).mkdir()
        with zipfile.ZipFile(f"{folder}/run.zip", "w") as archive:
            archive.writestr("run/run.json", "{}")
    script = (
        "import sys, contextlib\nfrom tacevo.cli.app import main\n"
        f"for words in {QUICK}:\n"
        "    with contextlib.suppress(SystemExit): assert main(words.split()) == 2, words\n"
        "print('slow:', sorted({'numpy', 'pydantic', 'torch', 'hydra', 'mlflow', 'rich'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert "slow: []" in out
    for command in OURS:
        assert re.search(rf"^  {command}\b", out, re.MULTILINE)


@pytest.mark.parametrize(
    "command",
    [
        [],
        *([name] for name in OURS),
        *([name, below] for name, command in OURS.items() for below in command.below),
    ],
    ids=" ".join,
)
def test_help_is_as_wide_as_a_terminal_and_ends_with_examples(
    command: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 80 columns on any terminal; and nothing of Hydra's own, or of what is gone, is in it."""
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main([*command, "--help"])
    told = capsys.readouterr().out
    assert [line for line in told.splitlines() if len(line) > WIDTH] == []
    assert f"  tacevo {' '.join(command)}".rstrip() in told.lower().partition("\nexamples:\n")[2]
    assert not {"--resolve", "--info"} & set(told.split())


def test_search_help_lists_the_groups(capsys: pytest.CaptureFixture[str]) -> None:
    """The choices of every config group can be read without opening a file."""
    with pytest.raises(SystemExit):
        main(["search", "--help"])
    assert re.search(r"^  task +force, grating, hardness, shape$", capsys.readouterr().out, re.MULTILINE)


def test_search_help_lists_every_setting_as_it_can_be_typed(capsys: pytest.CaptureFixture[str]) -> None:
    """With its default, and words behind it: all of them together change nothing."""
    with pytest.raises(SystemExit):
        main(["search", "--help"])
    told = re.findall(r"^  ([a-z_.]+=.*?)(?:  +\S.*)?$", capsys.readouterr().out, re.MULTILINE)
    groups = {key.rpartition(".")[0] for key in keys()}
    assert {setting.partition("=")[0] for setting in told} == set(keys()) - groups - {"parts", "code"}
    assert compose(told) == compose([])


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("asked", "settings"),
    [
        (["--cfg", "job"], ["experiment=demo", "seed=3"]),
        (["--resolve"], ["experiment=null"]),
        (["--info"], ["experiment=demo", "seed=3"]),
        (["-c", "job", "--info", "config"], ["experiment=null"]),
    ],
)
def test_settings_are_printed_as_hydra_users_ask_for_them(
    asked: list[str], settings: list[str], place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As YAML that can be read again; nothing is run."""
    assert main(["search", *settings, *asked]) == 0
    assert from_plain(yaml.safe_load(capsys.readouterr().out)) == compose(settings)
    assert {path.name for path in place.iterdir()} <= {"temporary"}


def test_check_judges_raw_answers(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One JSON object a line, with the fields that other tools rely on."""
    network = "class ImageRegressionCNN(nn.Module):\n    def __init__(self, num_outputs=3):\n"
    network += "        super().__init__()\n        self.fc = nn.Linear(3 * 32 * 32, num_outputs)\n\n"
    network += "    def forward(self, x):\n        return self.fc(x.flatten(1))\n"
    Path("good.txt").write_text(f"Here it is:\n\n```python\n{network}```\n")
    Path("bad.txt").write_text("I cannot do that.")
    assert main(["check", "good.txt", "bad.txt", "--task", "force", "--image-size", "32", "--json"]) == 0
    good, bad = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (good["file"], good["verdict"], good["parameters"]) == ("good.txt", "admitted", 3 * 32 * 32 * 3 + 3)
    assert (bad["verdict"], bad["stage"], bad["reason"]) == ("rejected", "extract", "no_class")


@pytest.mark.room("simulator", "grammar")
@pytest.mark.slow
@pytest.mark.parametrize("number", [pytest.param(signal.SIGKILL, marks=pytest.mark.slow), signal.SIGINT])
def test_stop_while_images_are_made_leaves_no_process(number: signal.Signals, tmp_path: Path) -> None:
    """The processes that make images end with the search, killed or interrupted; nothing is said to be kept."""
    many = ["experiment=demo", "tracking=none", "data.images=20000", "data.image_size=64"]
    search = subprocess.Popen(
        [*COMMAND, "search", *many], cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        assert eventually(lambda: kilobytes_of_images(tmp_path) >= 200, seconds=60)
        assert search.poll() is None
        if number is signal.SIGKILL:
            search.kill()
        else:
            os.killpg(search.pid, number)  # as a terminal does
        _, errors = search.communicate(timeout=60)
    finally:
        search.kill()  # it would search for minutes beside the other tests
    assert search.returncode == (-signal.SIGKILL if number is signal.SIGKILL else 130)
    if number is signal.SIGINT:  # no image is kept before all are made
        assert errors.splitlines()[-1].startswith("interrupted; ")
        assert "kept" not in errors
    assert ends(tmp_path), processes_of(tmp_path)


def kilobytes_of_images(folder: Path) -> int:
    """Measure what is written of the images that are being made; the file is sparse until then."""
    files = (folder / "cache" / "data").glob(".*/images.npy")
    return sum(file.stat().st_blocks // 2 for file in files)


def test_command_is_spelt_as_the_users_shell_finds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its name in an activated environment, else by its path."""
    programs = Path(sys.executable).parent
    monkeypatch.setenv("PATH", str(programs))
    assert as_typed("tacevo") == "tacevo"
    monkeypatch.setenv("PATH", "/nowhere")
    assert Path(as_typed("tacevo")).resolve() == (programs / "tacevo").resolve()


def test_directory_that_is_write_protected_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before any work is done for it; the administrator, who may write everywhere, is made another user here."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    with refused(ConfigError, place=str(tmp_path), got="write-protected", remedy="-o"):
        output_directory(tmp_path)


@pytest.mark.parametrize(
    ("command", "now"),
    [
        (["paper", "run", "-o", "out"], "`tacevo report RUN... --latex`"),
        (["sweep", "status", "all"], "`tacevo show SWEEP`"),
        (["watch", "run", "--open"], "`tacevo report RUN --follow`"),
        (["continue", "run", "search.generations=9"], "`tacevo extend RUN search.generations=N`"),
        (["rm", "run"], "`rm -r RUN`"),
        (["cache", "ls"], "`tacevo cache verify`"),
        (["cache", "explain", "KEY"], "`cat cache/KIND/KE/KEY.json`"),
    ],
)
def test_command_of_the_last_release_names_what_took_its_place(
    command: list[str], now: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever follows it."""
    assert main(command) == 2
    assert now in capsys.readouterr().err
