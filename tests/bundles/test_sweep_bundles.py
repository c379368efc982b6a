"""Promise: a sweep is one file, replayed whole; whoever edits its list of jobs or its runs is found out."""

import json
import lzma
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bundles import Members, Refused, entries_of, laid_out, members_of, resealed, with_entries
from tiny_sweep import OWN, edited, jobs_text

from tacevo.bundles.format import JOBS, STORE
from tacevo.bundles.open import opened
from tacevo.cli.app import main
from tacevo.reproduce.retrain import decisive
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Store
from tacevo.storage.sweep_directory import SweepDirectory, sweep_digest


@pytest.fixture
def whole(swept: Path) -> Members:
    """Return the members of a sound bundle."""
    return members_of(swept / "sweep.zip")


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Replay bundles in a directory of the test's own."""
    return Refused(tmp_path, capsys)


def with_candidate(members: Members, file: str, answer: Any = None) -> Members:
    """Return members with a further entry that holds a candidate's file."""
    entry = {
        "kind": "candidates",
        "request": {"file": file},
        "answer": {"text": "class Mine: pass\n"} if answer is None else answer,
    }
    return with_entries(members, [*entries_of(members), entry])


def run_of(members: Members, job: str) -> Members:
    """Return the files of one job's run, without its directory."""
    place = f"sweep/{job}/"
    return {name.removeprefix(place): data for name, data in members.items() if name.startswith(place)}


@pytest.mark.slow
def test_bytes_are_the_same_from_anywhere(swept: Path, tmp_path: Path) -> None:
    """Another directory and name of the sweep, other stores, and more in them; or itself, which has no overrides."""
    shutil.copytree(swept / "sweep", tmp_path / "elsewhere")
    shutil.copytree(swept / "cache", tmp_path / "stores")
    Store(tmp_path / "stores", "completions").write({"of": "another run"}, {"x": 1})
    for folder, store in (
        (tmp_path / "elsewhere", tmp_path / "stores"),
        laid_out(swept / "sweep.zip", tmp_path / "published"),
    ):
        command = ["publish", str(folder), "--store", str(store), "--author", "A. Nyone"]
        assert main([*command, "-o", str(tmp_path / "again.zip")]) == 0
        assert (tmp_path / "again.zip").read_bytes() == (swept / "sweep.zip").read_bytes()


def test_bundle_says_what_it_is_and_nothing_of_its_machine(swept: Path, whole: Members) -> None:
    """A sweep, its arms and seeds, and the digest of every run; a store entry that runs share is there once.

    What an arm is follows from the recorded configurations; no override of a publisher is there to be believed.
    """
    text = whole["README.md"].decode()
    assert "arms none, fixed_temperature, seeds 0, 1" in " ".join(text.split())
    for job in OWN:
        assert f"- run of job `{job}` `{json.loads(run_of(whole, job)['run.json'])['digest']}`" in text
    graph = json.loads(whole["ro-crate-metadata.json"])["@graph"]
    (action,) = (entity for entity in graph if entity["@type"] == "CreateAction")
    assert {ledger["@id"] for ledger in action["result"]} == {f"sweep/{job}/ledger.jsonl" for job in OWN}
    told = json.loads(whole[JOBS])
    arms = [(job["arm"], job["overrides"]) for job in told["jobs"]]
    assert (told["overrides"], arms) == ([], [("none", []), ("none", []), ("fixed_temperature", [])])
    assert "temperature.rule,paper,fixed" in whole["tables/more/ablation_settings.csv"].decode()
    members = {**whole, STORE: lzma.decompress(whole[STORE])}
    assert [name for name, data in members.items() if str(swept).encode() in data or b"/tmp/" in data] == []
    assert len(set(members[STORE].splitlines())) == len(members[STORE].splitlines())
    trained = [json.loads(line) for job in OWN for line in run_of(whole, job)["ledger.jsonl"].splitlines()]
    keys = {line["evaluation"] for line in trained if "evaluation" in line}
    assert sum(entry["kind"] == "evaluations" for entry in entries_of(whole)) == len(keys) < len(OWN) * 4


def test_replay_tells_every_digest_and_the_sweeps(swept: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A published sweep and its directory give the same; in an empty directory, nothing else is needed.

    Commands that take one run say so in one line, with what to do.
    """
    digests = {job: str(RunDirectory(swept / "sweep" / job).read_run().digest) for job in OWN}
    for name in ("sweep", "sweep.zip"):
        of = str(swept / name)
        for command, remedy in ((["extend", of, "search.generations=9"], "name one of its jobs, SWEEP/JOB"),):
            assert main(command) == 2
            assert f"expected one run; got a sweep of 3; {remedy}" in capsys.readouterr().err
        assert main(["replay", of]) == 0
        said = capsys.readouterr().out
        assert all(f"job {job}: digest {digest}\n" in said for job, digest in digests.items())
        assert said.endswith(f"digest: {sweep_digest(digests)}\n")
    assert said.splitlines()[-2].startswith("EQUAL: 3 searches, ")
    assert list(place.iterdir()) == []


@pytest.mark.slow
def test_retraining_draws_from_all_runs(swept: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The best network of each run, networks of studies, and two others; each counted once, and told with its job."""
    assert main(["replay", str(swept / "sweep.zip"), "--retrain", "2"]) == 0
    said = capsys.readouterr()
    bundle = opened(swept / "sweep.zip")
    certain = decisive([bundle.read(run) for run in bundle.runs])
    assert f"retrained: {len(certain) + 2} of" in said.out
    told = [line for line in said.err.splitlines() if ": as recorded (" in line]
    assert len(told) == len(certain) + 2
    assert all(line.split()[0] in OWN for line in told)


def test_published_sweep_is_shown_as_its_directory(swept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each job with its state and digest."""
    shown = []
    for sweep in (swept / "sweep.zip", swept / "sweep"):
        assert main(["show", str(sweep)]) == 0
        shown.append([line for line in capsys.readouterr().out.splitlines() if "| finished" in line])
    assert shown[0] == shown[1]
    assert len(shown[0]) == len(OWN)


def test_note_of_a_sweep_is_shown(swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What its makers tell its readers stands below its jobs, as it does below a run."""
    shutil.copytree(swept / "sweep", tmp_path / "sweep")
    (tmp_path / "sweep" / "NOTE.md").write_text("Two jobs ran twice.\n")
    assert main(["show", str(tmp_path / "sweep")]) == 0
    assert "> Two jobs ran twice." in capsys.readouterr().out.splitlines()


@pytest.mark.room("page")
def test_job_of_a_published_sweep_is_a_run(swept: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands that take a run take it by its name, and say the same as of its directory."""
    published, directory = f"{swept}/sweep.zip/none-seed1", f"{swept}/sweep/none-seed1"
    store = ["--store", str(swept / "cache")]
    for one, other in (
        (["show", published], ["show", directory]),
        (["show", published, "g00s00"], ["show", directory, "g00s00"]),
        (["replay", published], ["replay", directory, *store]),
        (["tables", published, "-o", "same"], ["tables", directory, "-o", "same", *store]),
    ):
        said = []
        for command in (one, other):
            assert main(command) == 0
            said.append(capsys.readouterr().out)
        assert said[0] == said[1]
    assert main(["report", published, "-o", "page.html"]) == 0
    page = (place / "page.html").read_text()
    assert "tacevo replay sweep.zip/none-seed1" in page
    assert "Every file of sweep.zip is as its manifest says" in page
    assert main(["figures", published]) == 2
    assert "name by -o where to write figures" in capsys.readouterr().err


@pytest.mark.room("page", "mlflow")
def test_job_of_a_published_sweep_is_not_believed(
    whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its replay finds what that of the whole sweep finds."""
    bundle = resealed(with_candidate(whole, "sweep/none-seed1/candidates/g99s99.py"), tmp_path / "x.zip")
    for command in (["replay", f"{bundle}/none-seed1"], ["extend", f"{bundle}/none-seed1", "search.generations=9"]):
        assert main(command) == 1
        assert "only files of the ledger; got g99s99.py" in capsys.readouterr().err
    assert main(["replay", f"{bundle}/none-seed0"]) == 0


@pytest.mark.slow
def test_job_of_a_published_sweep_is_continued(swept: Path, place: Path) -> None:
    """Its lines begin the ledger of the longer run."""
    job = f"{swept}/sweep.zip/none-seed1"
    assert main(["extend", job, "search.generations=2", "run.dir=longer", "tracking=none"]) == 0
    recorded = (swept / "sweep" / "none-seed1" / "ledger.jsonl").read_bytes()
    assert (place / "longer" / "ledger.jsonl").read_bytes().startswith(recorded)


def test_unfinished_sweep_is_not_published(swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every job that did not come to its end is named, with the reason where one is known; one store is packed."""
    shutil.copytree(swept / "sweep", tmp_path / "sweep")
    directory = SweepDirectory(tmp_path / "sweep")
    jobs = directory.read().jobs
    one = directory.run(jobs[1])
    told = one.read_run()
    one.write_run(replace(told, config={**told.config, "store": {"root": "other"}}))
    assert main(["publish", str(directory.path), "-o", str(tmp_path / "x.zip")]) == 2
    assert "expected runs with one store.root for all" in capsys.readouterr().err
    directory.fail(jobs[0], "the disk is full")
    shutil.rmtree(one.path)
    for run in (directory.run(jobs[0]), directory.run(jobs[2])):
        run.write_run(replace(run.read_run(), digest=None))
    for command in (["publish", str(directory.path), "-o", str(tmp_path / "x.zip")], ["replay", str(directory.path)]):
        assert main(command) == 2
        words = "none-seed0 (failed: the disk is full), none-seed1, fixed_temperature-seed0; repeat the"
        assert words in capsys.readouterr().err
    assert not (tmp_path / "x.zip").exists()


# From here on somebody edits a published sweep, and writes every checksum anew.


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "gone"}, "no directory of the job 'gone'"),
        ({"name": "../../evil"}, "expected the name of a directory; got '../../evil'"),
        ({"name": "none-seed0"}, "each of another name; got 'none-seed0' twice"),
        ({"arm": "mine"}, "arms 'none' and 'mine': expected different settings"),
        ({"seed": 9}, "sweep.json, job none-seed1, seed: expected 1"),
        ({"seed": "one"}, "sweep.json, jobs.1.seed: expected an integer"),
    ],
)
def test_edited_job_is_found(change: dict[str, Any], words: str, whole: Members, refused: Refused) -> None:
    """Where its run is, what it is called, and whose it is."""
    refused({**whole, JOBS: edited(whole[JOBS], 1, **change)}, words)


def test_dropped_or_added_job_is_found(whole: Members, refused: Refused) -> None:
    """The jobs and the directories are the same."""
    told = json.loads(whole[JOBS])
    fewer = {**told, "jobs": told["jobs"][:2]}
    refused({**whole, JOBS: jobs_text(fewer)}, "got directory 'fixed_temperature-seed0', which is not a job")
    refused({**whole, JOBS: jobs_text({**told, "jobs": []})}, "each of another name; got no job")
    kept = [entry for entry in entries_of(whole) if "none-seed1/" not in entry["request"].get("file", "")]
    without = with_entries(
        {name: data for name, data in whole.items() if not name.startswith("sweep/none-seed1/")}, kept
    )
    refused(without, "no directory of the job 'none-seed1'")
    refused(
        {**without, JOBS: jobs_text({**told, "jobs": told["jobs"][::2]})}, "expected only entries that the replay reads"
    )


def test_other_spelling_of_the_jobs_is_found(whole: Members, refused: Refused) -> None:
    """What reads alike is not what was published, and an unknown field could say anything."""
    told = json.loads(whole[JOBS])
    refused({**whole, JOBS: json.dumps(told).encode()}, "expected the text that `tacevo publish` writes")
    refused({**whole, JOBS: jobs_text({**told, "author": "me"})}, "author: expected only keys of this version")


def test_runs_that_changed_places_are_found(whole: Members, refused: Refused) -> None:
    """Each is sound in itself."""
    one, other = (run_of(whole, job) for job in ("none-seed0", "fixed_temperature-seed0"))
    swapped = {f"sweep/fixed_temperature-seed0/{name}": data for name, data in one.items()}
    swapped |= {f"sweep/none-seed0/{name}": data for name, data in other.items()}
    rest = {name: data for name, data in whole.items() if not name.startswith(("sweep/none-seed0/", "sweep/fixed"))}
    refused({**rest, **swapped}, "sweep.json, job none-seed0, config: expected")


def test_edited_run_is_named_with_its_job(whole: Members, refused: Refused) -> None:
    """A difference in one of many runs is told with the job."""
    edited_file = {"file": "sweep/none-seed1/candidates/g00s00.py"}
    entries = entries_of(whole)
    (entry,) = (one for one in entries if one["request"] == edited_file)
    entry["answer"]["text"] += "# mine\n"
    refused(with_entries(whole, entries), "candidates/g00s00.py: expected the text that was judged")
    foreign = with_candidate(whole, "sweep/none-seed1/candidates/g99s99.py")
    for words in ("job none-seed1, ", "only files of the ledger; got g99s99.py"):
        refused(foreign, words)
    refused(with_entries(whole, [one for one in entries if one is not entry]), "job none-seed1, ")


def test_packed_candidates_are_the_files_of_the_sweep(swept: Path, whole: Members) -> None:
    """Each file once, unpacked byte for byte where the directory has it, and none of them a member."""
    assert [name for name in whole if "/candidates/" in name] == []
    place = opened(swept / "sweep.zip")
    packed = {(run.name, path.name): path.read_bytes() for run in place.runs for path in run.glob("candidates/*")}
    assert {run for run, _ in packed} == set(OWN)
    assert all(
        (swept / "sweep" / run / "candidates" / name).read_bytes() == data for (run, name), data in packed.items()
    )


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "file",
    [
        "sweep/gone/candidates/g00s01.py",
        "sweep/none-seed1/candidates/../run.json",
        "sweep/none-seed1/candidates/g00s00.txt",
        "sweep/sweep.json/candidates/g00s01.py",
        "sweep/../candidates/g00s01.py",
        "run/candidates/g00s01.py",
        "/tmp/candidates/g00s01.py",
        f"sweep/none-seed1/candidates/g{'0' * 200}s00.py",
    ],
)
def test_candidate_outside_its_place_is_found(file: str, whole: Members, refused: Refused) -> None:
    """No entry writes a file that is not a candidate's of a job that is there."""
    refused(with_candidate(whole, file), "expected files of a sweep's candidates, each once; got ")


def test_candidate_twice_or_without_its_text_is_found(whole: Members, refused: Refused) -> None:
    """Beside its member as beside another entry; nor is anything but text a candidate's."""
    file = "sweep/none-seed1/candidates/g00s00.py"
    refused({**whole, file: b"class Mine: pass\n"}, "expected files of a sweep's candidates, each once")
    refused(with_candidate(whole, file), "a second time")
    other = "sweep/none-seed1/candidates/g99s99.py"
    half = lzma.decompress(with_candidate(whole, other, answer={"text": "HALF"})[STORE]).replace(b"HALF", b"\\ud800")
    refused({**whole, STORE: lzma.compress(half)}, "expected JSON; got ")
    for answer in ({"text": 1}, {}, ["text"], {"text": "class Mine: pass\n", "note": "mine"}):
        refused(with_candidate(whole, other, answer=answer), "expected files of a sweep's candidates, each once")
    listed = {"kind": "candidates", "request": ["file"], "answer": {"text": "class Mine: pass\n"}}
    refused(with_entries(whole, [*entries_of(whole), listed]), "expected files of a sweep's candidates, each once")


def test_members_of_an_older_bundle_are_read(swept: Path, whole: Members, tmp_path: Path) -> None:
    """Releases before this one kept a sweep's candidates as members."""
    entries = entries_of(whole)
    old = {one["request"]["file"]: one["answer"]["text"].encode() for one in entries if one["kind"] == "candidates"}
    assert len(old) == sum(1 for _ in (swept / "sweep").glob("*/candidates/*"))
    rest = with_entries(whole, [one for one in entries if one["kind"] != "candidates"])
    assert main(["replay", str(resealed({**rest, **old}, tmp_path / "old.zip"))]) == 0


def test_bundle_is_a_run_or_a_sweep(whole: Members, refused: Refused) -> None:
    """Not both, and not a half of either."""
    both = {**whole, **{f"run/{name}": data for name, data in run_of(whole, "none-seed0").items()}}
    refused(both, "expected files of a published sweep only; got 'run/archive.json'")
    refused({name: data for name, data in whole.items() if name != JOBS}, "a file without sweep/sweep.json")
    ledger = "sweep/none-seed1/ledger.jsonl"
    refused({name: data for name, data in whole.items() if name != ledger}, f"a file without {ledger}")


def test_job_does_not_take_the_walls_down(whole: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One job of many is enough for a refusal."""
    name = "sweep/none-seed1/run.json"
    run = json.loads(whole[name])
    run["config"]["sandbox"]["require"] = "none"
    bundle = resealed({**whole, name: json.dumps(run).encode()}, tmp_path / "x.zip")
    job = f"{bundle}/none-seed1"
    for command in (["replay", str(bundle), "--retrain", "1"], ["replay", job, "--retrain", "1"], ["extend", job]):
        assert main(command) == 1
        assert "sandbox.require=none, with which its candidates would run here without walls" in capsys.readouterr().err
