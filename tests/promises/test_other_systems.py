"""Promise: what trains nothing works beyond Linux on x86-64, and gives the same bytes; what needs Linux says so."""

import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest
from checkout import BUNDLES, ROOT
from commands import tacevo
from test_shipped import SHIPPED

from tacevo.cli.app import main

#: Said in the process of a command, before it imports anything else.
LESSER = "import lesser_system; lesser_system.hide()"

#: What `make aarch64` makes.
AARCH64 = ROOT / "build" / "aarch64"


@pytest.fixture
def _lesser(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let texts be ASCII unless they are said to be UTF-8, as Windows lets them be of its own encoding."""
    for name, value in {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}.items():
        monkeypatch.setenv(name, value)


def contents(folder: Path) -> dict[str, bytes]:
    """Read the files of a directory, at any depth."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.usefixtures("_lesser")
def test_published_run_is_replayed_on_a_lesser_system(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without `fcntl`, `fork`, /proc, most signals, and with files that cannot be renamed while they are open."""
    assert main(["replay", str(bundle)]) == 0
    assert tacevo("replay", bundle, before=LESSER).stdout == capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("_lesser")
def test_results_are_read_on_a_lesser_system(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What a run found, its tables, figures and page are, byte for byte, what they are here; a sweep's, too."""
    run, sweep = BUNDLES / "grating-grammar.zip", BUNDLES / "ablation-force-grammar.zip"
    commands: dict[str, list[str | Path]] = {
        "tables": ["tables", run],
        "figures": ["figures", run, "--format", "svg"],
        "report": ["report", run],
        "ablations": ["ablations", sweep],
    }
    for name, command in commands.items():
        for folder, before in (("here", ""), ("there", LESSER)):
            (place / folder / name).mkdir(parents=True)
            output = Path(folder, name, *(["page.html"] if name == "report" else []))
            tacevo(*command, "-o", output, before=before)
    assert contents(place / "there") == contents(place / "here")
    assert main(["show", str(run)]) == 0
    assert (
        tacevo("show", run, before=LESSER).stdout
        == capsys.readouterr().out.encode("ascii", "backslashreplace").decode()
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("command", ["search experiment=demo", "study task=force", "doctor"])
def test_what_needs_the_sandbox_says_so(command: str, place: Path) -> None:
    """In one line, which names what works all the same; nothing is made."""
    done = tacevo(*command.split(), before=LESSER, status=1 if command == "doctor" else 2)
    (said,) = [line for line in (done.stdout + done.stderr).splitlines() if "got not Linux" in line]
    assert "expected Linux on x86-64 or aarch64" in said
    assert "replay, show, tables, figures and report need no sandbox" in said
    assert not (place / "runs").exists()


def test_names_in_published_files_suit_every_system() -> None:
    """Windows lacks some characters and names, and paths of over 260 characters, of which a user needs some."""
    for bundle in (*SHIPPED, *BUNDLES.glob("*.zip")):
        names = zipfile.ZipFile(bundle).namelist()
        assert max(map(len, names)) <= 160
        assert [name for name in names if re.search(r'[<>:"|?*\\\x00-\x1f]|[ .](/|$)', name)] == []
        assert [name for name in names if re.search(r"(?i)(^|/)(con|prn|aux|nul|com\d|lpt\d)(\.|/|$)", name)] == []
        assert len({name.casefold() for name in names}) == len(names)


@pytest.mark.portable
@pytest.mark.timeout(7_200)
@pytest.mark.parametrize(
    "command", [["replay"], ["show"], ["tables", "-o", "out"], ["report", "-o", "out.html"]], ids=lambda words: words[0]
)
def test_aarch64_gives_the_same_bytes(command: list[str], place: Path) -> None:
    """Of a published run with studies, under an emulator, without torch."""
    emulator = shutil.which("qemu-aarch64")
    if emulator is None or not (AARCH64 / "site").exists():
        pytest.skip("no qemu-aarch64 (package qemu-user), or no build/aarch64: `make aarch64`")
    python = [emulator, "-L", str(AARCH64 / "root"), str(AARCH64 / "root" / "usr" / "bin" / "python3.11")]
    words = [command[0], str(BUNDLES / "grating-grammar.zip"), *command[1:]]
    given = {}
    for folder, started, path in (("here", ["python"], ROOT), ("there", python, f"{AARCH64 / 'site'}:{ROOT}")):
        (place / folder).mkdir()
        if folder == "here":
            said = tacevo(*words, cwd=place / folder).stdout
        else:
            environment = {**os.environ, "PYTHONPATH": str(path)}
            said = subprocess.run(
                [*started, "-m", "tacevo", *words],
                cwd=place / folder,
                env=environment,
                stdout=subprocess.PIPE,
                text=True,
                check=True,
            ).stdout
        given[folder] = (contents(place / folder), [line for line in said.splitlines() if "version" not in line])
    assert given["there"] == given["here"]
