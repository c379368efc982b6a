"""A wheel built from the tree carries the configs and works outside the checkout; its version is one everywhere."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from checkout import ROOT
from smallest import SMALLEST, UNTRACKED

from tacevo import __version__


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel."""
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (built,) = out.glob("*.whl")
    return built


def test_version_is_the_same_wherever_it_stands() -> None:
    """In the package, in its metadata, and in CITATION.cff, whose date is that of the version in the changelog."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert cited["version"] == project["version"] == __version__
    assert re.findall(r"^## (\d\S*) \((\S+)\)$", changes, re.M)[0] == (__version__, str(cited["date-released"]))


def test_wheel_carries_every_config_and_no_test(wheel: Path) -> None:
    """Every file below conf/ is in the wheel, under the package."""
    names = set(zipfile.ZipFile(wheel).namelist())
    configs = {path.relative_to(ROOT) for path in (ROOT / "conf").rglob("*") if path.is_file()}
    assert {f"tacevo/{path.as_posix()}" for path in configs} <= names
    assert "analysis/__init__.py" in names
    page = ROOT / "analysis" / "report" / "page"
    assert {path.relative_to(ROOT).as_posix() for path in page.iterdir() if path.is_file()} <= names
    assert not {name for name in names if name.startswith(("tests/", "benchmarks/"))}


@pytest.mark.slow
def test_wheel_searches_outside_the_checkout(wheel: Path, tmp_path: Path) -> None:
    """Unpacked elsewhere, the command composes its own configs and runs a search, sandbox and all."""
    library = tmp_path / "library"
    zipfile.ZipFile(wheel).extractall(library)
    overrides = [*SMALLEST, UNTRACKED, "search.generations=1", "search.candidates=2", "search.initial=1"]

    def python(*arguments: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(library)}
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True, check=True
        ).stdout.strip()

    assert "digest: " in python("-m", "tacevo.cli.app", "search", *overrides)
    where = python("-c", "import tacevo.config.folder; print(tacevo.config.folder.conf_root())")
    assert where == str(library / "tacevo" / "conf")
