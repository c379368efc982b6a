"""What is built is complete and works outside the checkout, wherever the user stands; its version is one everywhere."""

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from bundles import members_of
from checkout import ROOT
from smallest import SIMULATED, UNTRACKED

from tacevo import __version__

#: Python files that a user may have where a command is started; none of them is imported.
OTHERS = ("analysis/__init__.py", "random.py", "tests.py", "torch.py", "typing.py", "yaml.py")


#: What those who only check results do without: trainings, MLflow, a model's client.
NOT_TO_CHECK = {"torch", "mlflow", "anthropic", "httpx2"}


def test_what_only_checks_is_a_part_of_what_runs() -> None:
    """Its packages are those of the project but for four, with what installs a clone, at the versions of the whole."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    needed = {re.split(r"[<>=~]", one)[0] for one in project["project"]["dependencies"]} - NOT_TO_CHECK
    listed = (ROOT / "requirements-check.in").read_text(encoding="utf-8").splitlines()
    assert {line for line in listed if not line.startswith("#")} == needed | {"editables", "hatchling"}
    pins = {
        name: (ROOT / f"{name}.lock").read_text(encoding="utf-8") for name in ("requirements", "requirements-check")
    }
    versions = {name: set(re.findall(r"(?m)^\S+==\S+", text)) for name, text in pins.items()}
    assert versions["requirements-check"] < versions["requirements"]
    assert {pin.partition("==")[0].lower() for pin in versions["requirements-check"]} >= needed
    assert not {pin.partition("==")[0].lower() for pin in versions["requirements-check"]} & NOT_TO_CHECK


def built(kind: str, out: Path) -> Path:
    """Build the package, a `wheel` or an `sdist`, from the checkout."""
    command = [sys.executable, "-m", "build", f"--{kind}", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (file,) = out.iterdir()
    return file


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel."""
    return built("wheel", tmp_path_factory.mktemp("wheel"))


def tracked(*folders: str) -> set[str]:
    """List the files of the checkout below directories, all without any, as Git would commit them."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *folders]
    listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()
    return {name for name in listed if (ROOT / name).is_file()}


def test_version_is_the_same_wherever_it_stands() -> None:
    """In package, metadata, references and CITATION.cff, whose date is that of the version in the changelog."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    entry = (ROOT / "docs/references.bib").read_text(encoding="utf-8").partition("@software{tacevo_software")[2]
    written = dict(re.findall(r"^  (\w+) += \{+(.+?)\}+,?$", entry.partition("\n}")[0], re.M))
    assert cited["version"] == project["version"] == written["version"] == __version__
    assert (written["title"], written["date"]) == (cited["title"], str(cited["date-released"]))
    assert written["author"] == cited["authors"][0]["name"]
    assert re.findall(r"^## (\d\S*) \((\S+)\)$", changes, re.M)[0] == (__version__, str(cited["date-released"]))


def test_wheel_has_every_file_of_the_program_and_no_other(wheel: Path) -> None:
    """The two packages, the configs within the first, and what describes them."""
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert names == tracked("tacevo", "analysis") | {f"tacevo/{name}" for name in tracked("conf")}


@pytest.mark.slow
def test_source_distribution_has_every_file(tmp_path: Path) -> None:
    """Of the checkout, so that its tests run, and its published runs replay."""
    with tarfile.open(built("sdist", tmp_path)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names == tracked() | {"PKG-INFO"}


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel, and return its command; what it needs is that of this environment."""
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, symlinks=True)
    library = Path(sysconfig.get_path("purelib", "venv", vars={"base": str(place)}))
    # Behind the wheel; where a `.pth` names a directory, that of this checkout's own installation is not followed.
    (library / "needed.pth").write_text(sysconfig.get_path("purelib"))
    python = str(place / "bin" / "python")
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(pip, check=True)
    asked = [python, "-P", "-c", "import tacevo; print(tacevo.__file__)"]
    assert Path(subprocess.run(asked, check=True, capture_output=True, text=True).stdout).is_relative_to(place)
    return place / "bin" / "tacevo"


@pytest.mark.room("simulator", "grammar", "init", "publishing")
@pytest.mark.slow
def test_installed_wheel_does_everything_in_any_directory(installed: Path, tmp_path: Path) -> None:
    """A task of one's own, a search, a sweep, a study, tables and a replay, amid files that bear the names of modules.

    What was read of the task is in the run, which replays where the task is not.
    """
    for name in OTHERS:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("raise SystemExit('another module of this name was imported')")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()

    def tacevo(*words: str, cwd: Path = tmp_path) -> str:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        command = [str(installed), *words]
        return subprocess.run(
            command, cwd=cwd, env=environment, stdout=subprocess.PIPE, text=True, check=True
        ).stdout.strip()

    small = [*SIMULATED, UNTRACKED, "search.generations=1", "search.candidates=2", "search.initial=1"]
    tacevo("init", "shear", "--like", "force")
    own = [*small, "task=shear", "task.name=force"]  # simulated images go by the name
    said = tacevo("search", *own, "run.dir=mine")
    assert "digest: " in said
    assert "library/shear/system.md" in (tmp_path / "mine" / "run.json").read_text()
    assert "1 job: 1 finished" in tacevo("search", "-m", *own, "seed=1", "--into", "many")
    tacevo("study", "mine", "elites=1", "seeds=4", "epochs=1")
    tacevo("tables", "mine")
    assert (tmp_path / "mine" / "tables" / "index.md").exists()
    tacevo("publish", "mine", "-o", "mine.zip")
    pins = members_of(tmp_path / "mine.zip")["requirements.lock"].decode().splitlines()
    assert f"numpy=={version('numpy')}" in pins
    assert f"torch=={version('torch').partition('+')[0]}" in pins

    (tmp_path / "conf").rename(elsewhere / "not read")
    digest = said.splitlines()[-1]
    assert tacevo("replay", "../mine", "--store", "../cache", cwd=elsewhere).splitlines()[-1] == digest
