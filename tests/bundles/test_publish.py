"""Promise: one run gives one sequence of bytes, an RO-Crate in which nothing tells of the machine that wrote it."""

import hashlib
import json
import lzma
import os
import shutil
import socket
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml
from bundles import entries_of, members_of
from commands import publish
from rocrate.rocrate import ROCrate
from smallest import SIMULATED, UNTRACKED

from tacevo.bundles.format import STORE
from tacevo.cli.app import main
from tacevo.storage.run_directory import MANIFEST
from tacevo.storage.store import SEARCHED, Store

pytestmark = pytest.mark.room("publishing")


@pytest.mark.slow  # quick: tests/promises/test_invariances.py
def test_bytes_are_the_same_from_anywhere(published: Path, tmp_path: Path) -> None:
    """Another directory and name of the run, other stores, time zone, umask, hash seed, locale, working directory."""
    shutil.copytree(published / "run", tmp_path / "elsewhere")
    shutil.copytree(published / "cache", tmp_path / "stores")
    Store(tmp_path / "stores", "completions").write({"of": "another run"}, {"x": 1})
    strange = {
        "TZ": "Pacific/Kiritimati",
        "PYTHONHASHSEED": "7",
        "LC_ALL": "C",
        "HOME": str(tmp_path),
        "USER": "nobody",
    }
    command = [sys.executable, "-m", "tacevo.cli.app", "publish", "elsewhere", "-o", "again.zip", "--store", "stores"]
    subprocess.run(
        [*command, "--author", "A. Nyone"],
        cwd=tmp_path,
        env={**os.environ, **strange},
        umask=0o077,
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "again.zip").read_bytes() == (published / "run.zip").read_bytes()


def test_nothing_tells_of_the_machine(published: Path) -> None:
    """Neither a directory nor the host's name stands in any member, packed or not."""
    members = members_of(published / "run.zip")
    members[STORE] = lzma.decompress(members[STORE])
    told = [name for name, data in members.items() if str(published).encode() in data or b"/tmp/" in data]
    assert told == []
    host = socket.gethostname().encode()
    assert [name for name, data in members.items() if host in data.split()] == []


@pytest.mark.slow
def test_settings_of_one_machine_and_unfinished_studies_are_left_out(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Paths, addresses and a tracker decide no result, and a study at work is named; the rest replays as any bundle."""
    shutil.copytree(published / "run", tmp_path / "run")
    (study,) = (tmp_path / "run" / "studies").iterdir()
    told = json.loads((study / "study.json").read_text())
    (study / "study.json").write_text(json.dumps({**told, "digest": None}))
    run = json.loads((tmp_path / "run" / "run.json").read_text())
    run["config"]["tracking"] = {"kind": "mlflow", "uri": "http://secret-host:5000", "experiment": "tacevo"}
    run["config"]["llm"] |= {"base_url": "http://secret-host:8000/v1", "prices": "/home/secret-user/prices.yaml"}
    run["config"]["data"]["root"] = "/home/secret-user/images"
    run["config"]["task"] |= {"baseline": "/home/secret-user/baseline.py"}
    (tmp_path / "run" / "run.json").write_text(json.dumps(run))
    assert main(["publish", str(tmp_path / "run"), "-o", str(tmp_path / "x.zip")]) == 0
    said = capsys.readouterr()
    assert f"study {study.name} is left out: it is not finished" in said.err
    assert "author: anonymous" in said.out
    assert "the labels of" not in said.out
    members = members_of(tmp_path / "x.zip")
    assert not [name for name in members if "studies" in name]
    assert [name for name, data in members.items() if b"secret" in data] == []
    assert json.loads(members["run/run.json"])["config"]["data"]["root"] == "images"
    assert main(["replay", str(tmp_path / "x.zip")]) == 0


@pytest.mark.slow
def test_run_of_another_release_is_published_with_todays_summary(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Words and tables of one bundle are of one release, which its run.json names; its maker is told what is in it."""
    shutil.copytree(published / "run", tmp_path / "run")
    described = json.loads((tmp_path / "run" / "run.json").read_text())
    (tmp_path / "run" / "run.json").write_text(json.dumps({**described, "pages": described["pages"] - 1}))
    (tmp_path / "run" / "summary.md").write_text("As it was told then.\n")
    assert main(["publish", str(tmp_path / "run"), "-o", str(tmp_path / "x.zip"), "--author", "A. Nyone"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert {"licence: CC-BY-4.0", "author: A. Nyone", "the labels of 4 test images are in it"} <= {*said}
    made, own = members_of(tmp_path / "x.zip"), members_of(published / "run.zip")
    assert (made["run/summary.md"], made["run/run.json"]) == (own["run/summary.md"], own["run/run.json"])


def test_bundle_holds_all_that_was_asked_for(published: Path) -> None:
    """The run's files, its study, every kind of store entry, tables, figures, licence, citation, lock, checksums."""
    members = members_of(published / "run.zip")
    (study,) = (published / "run" / "studies").iterdir()
    kept = {f"run/candidates/{path.name}" for path in (published / "run" / "candidates").iterdir()}
    assert kept | {f"run/studies/{study.name}/{name}" for name in ("study.json", "scores.jsonl")} <= members.keys()
    for name in ("ledger.jsonl", "archive.json", "prompts.json", "summary.md", "timings.jsonl"):
        assert members[f"run/{name}"] == (published / "run" / name).read_bytes()
    assert {entry["kind"] for entry in entries_of(members)} == {*SEARCHED, "arrays", "studies"}
    assert {
        "tables/index.md",
        "tables/gate.csv",
        "tables/more/generations.csv",
        f"tables/{study.name}/verdicts.tex",
    } <= members.keys()
    assert {"figures/network_map.pdf", f"figures/{study.name}/seed_boxes.pdf"} <= members.keys()
    assert {"LICENSE.txt", "CITATION.cff", "README.md", "requirements.lock"} <= members.keys()


def test_bundle_pins_what_ran_where_no_lock_file_has_it(run: Path, published: Path) -> None:
    """As from a wheel, beside which no lock file lies, or in another environment; only versions become pins."""
    told = json.loads((run / "run.json").read_text())
    told["versions"] |= {"numpy": "9.9.9", "torch": "8.8+cu118", "scipy": "1.0\nevil==1.0", "mlflow": "absent"}
    (run / "run.json").write_text(json.dumps(told))
    assert main(["publish", str(run), "-o", "other.zip", "--store", str(published / "cache")]) == 0
    members = members_of(Path("other.zip"))
    pins = members["requirements.lock"].decode().splitlines()
    assert {"numpy==9.9.9", "torch==8.8"} <= {*pins}
    assert not [pin for pin in pins if "scipy" in pin or "evil" in pin or "mlflow" in pin or "tacevo==" in pin]
    assert "requirements.lock pins every package" not in members["README.md"].decode()
    assert "pins every package" in members_of(published / "run.zip")["README.md"].decode()


def test_manifest_is_what_sha256sum_reads(published: Path, tmp_path: Path) -> None:
    """Every other member stands in it; its own digest is printed."""
    with zipfile.ZipFile(published / "run.zip") as archive:
        archive.extractall(tmp_path)
    lines = [line.split("  ") for line in (tmp_path / MANIFEST).read_text().splitlines()]
    assert {name for _, name in lines} == members_of(published / "run.zip").keys() - {MANIFEST}
    assert all(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest for digest, name in lines)


def test_crate_is_sound(published: Path, tmp_path: Path) -> None:
    """What the standard demands: root, name, description, licence, date, and every file as a part of it."""
    with zipfile.ZipFile(published / "run.zip") as archive:
        archive.extractall(tmp_path)
        names = set(archive.namelist())
    graph = json.loads((tmp_path / "ro-crate-metadata.json").read_text())
    assert graph["@context"] == "https://w3id.org/ro/crate/1.1/context"
    entities = {entity["@id"]: entity for entity in graph["@graph"]}
    assert len(entities) == len(graph["@graph"])
    about = entities["ro-crate-metadata.json"]
    assert (about["conformsTo"], about["about"]) == ({"@id": "https://w3id.org/ro/crate/1.1"}, {"@id": "./"})
    root = entities["./"]
    assert root["@type"] == "Dataset"
    assert {part["@id"] for part in root["hasPart"]} == names - {"ro-crate-metadata.json"}
    assert all(entities[part["@id"]]["@type"] == "File" for part in root["hasPart"])
    assert entities[root["license"]["@id"]]["name"] == "CC-BY-4.0"
    ended = json.loads((published / "run" / "timings.jsonl").read_text().splitlines()[-1])["at"]
    assert root["datePublished"] == ended[:10]
    assert [person["name"] for person in ROCrate(str(tmp_path)).root_dataset["author"]] == ["A. Nyone"]


@pytest.mark.room("simulator", "grammar")
def test_readme_and_citation_say_what_it_is_and_how_to_replay_it(place: Path) -> None:
    """No LLM answered, the command that makes the images is complete; the Citation File Format has its fields."""
    assert main(["search", *SIMULATED, UNTRACKED, "search.generations=0", "search.initial=1", "run.dir=run"]) == 0
    publish("run", "-o", "run.zip", "--author", "A. Nyone")
    members = members_of(place / "run.zip")
    cited = yaml.safe_load(members["CITATION.cff"])
    assert (cited["cff-version"], cited["authors"]) == ("1.2.0", [{"name": "A. Nyone"}])
    assert {"title", "message", "date-released", "license"} <= cited.keys()
    (root,) = (one for one in json.loads(members["ro-crate-metadata.json"])["@graph"] if one["@id"] == "./")
    assert "no LLM" in root["description"]
    text = members["README.md"].decode()
    assert "no LLM" in text
    assert "tacevo replay THIS_FILE.zip" in text
    run = json.loads((place / "run" / "run.json").read_text())
    assert run["data"]["fingerprint"] in text
    assert f"tacevo data simulate task=force data.images={run['config']['data']['images']} " in text


@pytest.mark.slow
def test_only_the_named_study_is_published(published: Path, tmp_path: Path) -> None:
    """And the store entries of others stay at home."""
    shutil.copytree(published / "run", tmp_path / "run")
    shutil.copytree(published / "cache", tmp_path / "cache")
    store = f"store.root={tmp_path / 'cache'}"
    assert main(["study", f"run={tmp_path / 'run'}", "elites=1", "seeds=2", "epochs=1", store]) == 0
    (study,) = (tmp_path / "run" / "studies").glob("*seeds2*")
    publish = ["publish", str(tmp_path / "run"), str(study), "-o", str(tmp_path / "x.zip")]
    assert main([*publish, "--store", str(tmp_path / "cache")]) == 0
    members = members_of(tmp_path / "x.zip")
    assert {name.split("/")[2] for name in members if name.startswith("run/studies/")} == {study.name}
    assert sum(entry["kind"] == "studies" for entry in entries_of(members)) == 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--license", "as you like"], "--license: expected an SPDX identifier such as CC-BY-4.0; got 'as you like'"),
        (["--date", "yesterday"], "--date: expected a day as YYYY-MM-DD; got 'yesterday'"),
        (["--date", "20260102"], "--date: expected a day as YYYY-MM-DD; got '20260102'"),
        (["--author", " "], "--author: expected a name"),
        (["elsewhere"], "expected the directory of a finished study of "),
    ],
)
def test_terms_and_studies_that_cannot_be_published_are_refused(
    options: list[str], words: str, published: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is replayed, in one line."""
    assert main(["publish", str(published / "run"), *options, "-o", "x.zip"]) == 2
    assert words in capsys.readouterr().err
    assert not (place / "x.zip").exists()


def test_run_that_cannot_be_published_leaves_no_file(
    run: Path, swept: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Publishing begins with a replay; the day on which a run ended is told by its times; a sweep has all studies."""
    edited = run / "candidates" / "g00s00.py"
    edited.write_text(edited.read_text() + "# edited\n")
    assert main(["publish", str(run), "-o", "x.zip"]) == 1
    judged = "run/candidates/g00s00.py: expected the text that was judged; got another text: it was edited"
    assert judged in capsys.readouterr().err
    (run / "timings.jsonl").unlink()
    assert main(["publish", str(run), "-o", "x.zip"]) == 2
    told = capsys.readouterr().err
    assert "run/timings.jsonl: expected lines with the time of each slot; got no line; set --date YYYY-MM-DD" in told
    assert main(["publish", str(swept / "sweep"), "a_study", "-o", "x.zip"]) == 2
    assert "expected no study: a sweep is published with every finished study" in capsys.readouterr().err
    assert not (place / "x.zip").exists()
