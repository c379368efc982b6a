"""The examples are what their pages say, and their ablation is replayed by whoever does not have the package."""

import importlib.util
import shutil
import zipfile
from pathlib import Path

import pytest
from bundles import members_of
from checkout import ROOT
from commands import publish, tacevo
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED, Once

EXAMPLES = ROOT / "examples"

PACKAGE = EXAMPLES / "tacevo_lexicase/tacevo_lexicase"


def test_ablation_is_replayed_without_the_package(tmp_path: Path) -> None:
    """All four searches are EQUAL; whose decisions were taken from the record is said."""
    assert importlib.util.find_spec("tacevo_lexicase") is None
    done = tacevo("replay", EXAMPLES / "lexicase.zip", cwd=tmp_path).stdout
    assert "EQUAL: 4 searches" in done
    assert done.count("--trust-parts lets its recorded sources decide again") == 2


def test_ablation_is_decided_again_with_trust(tmp_path: Path) -> None:
    """By the sources in the bundle."""
    done = tacevo("replay", EXAMPLES / "lexicase.zip", "--trust-parts", cwd=tmp_path).stdout
    assert done.count("as its recorded sources decide, confined") == 2


@pytest.mark.parametrize(("name", "runs"), [("parents.py", 2), ("sources.py", 0)])
def test_published_ablation_has_the_rule_that_a_reader_sees(name: str, runs: int) -> None:
    """The single file is the module of the package itself, by a link."""
    assert (EXAMPLES / "parts" / name).samefile(PACKAGE / name)
    recorded = [data for place, data in members_of(EXAMPLES / "lexicase.zip").items() if place.endswith(name)]
    assert recorded == [(PACKAGE / name).read_bytes()] * runs


def _sweep(folder: Path) -> None:
    shutil.copytree(EXAMPLES / "parts", folder / "parts")
    arms = f"proposals.parents=uniform,{folder / 'parts/parents.py'}:Ageing"
    terms = ["seed=0", "--reference", "proposals.parents=uniform", "--into", "sweep"]
    tacevo("search", "-m", *SMALLEST, UNTRACKED, *PUBLISHED_SIZES, "store.root=cache", arms, *terms, cwd=folder)
    publish("sweep", "-o", "sweep.zip", cwd=folder)


@pytest.fixture(scope="module")
def swept(once: Once) -> Path:
    """Return a folder with a sweep over a rule of ours and one in a file, and its bundle."""
    return once("sweep_of_parts", _sweep)


def test_jobs_of_a_sweep_have_the_sources_of_their_parts(swept: Path, tmp_path: Path) -> None:
    """Each is a process of its own; whoever has the bundle alone replays it, also with trust."""
    for options in ([], ["--trust-parts"]):
        assert "EQUAL: 2 searches" in tacevo("replay", swept / "sweep.zip", *options, cwd=tmp_path).stdout


def test_bundle_of_a_sweep_names_no_place_of_the_machine(swept: Path) -> None:
    """An arm of a part in a file is published under the name of its class."""
    with zipfile.ZipFile(swept / "sweep.zip") as bundle:
        assert not [name for name in bundle.namelist() if str(swept).encode() in bundle.read(name)]
        assert b"proposals.parents=Ageing" in bundle.read("sweep/sweep.json")
