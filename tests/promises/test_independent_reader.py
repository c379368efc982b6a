"""Promise: examples/independent_reader.py, which imports nothing of ours, checks every published file, and finds edits.

docs/formats.md says which edits it cannot find.
"""

import base64
import json
import lzma
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bundles import Members, honest, members_of, zipped
from checkout import BUNDLES, GOLDEN, PUBLISHED, ROOT

from tacevo.bundles.format import read_bundle
from tacevo.cli.app import main
from tacevo.storage.canonical import canonical
from tacevo.storage.ledger import GENESIS, seal

READER = ROOT / "examples/independent_reader.py"

#: Small bundles of several releases: a run and a noise run, a study with its predictions, a sweep, a first release.
SMALL = (
    GOLDEN / "demo.zip",
    PUBLISHED / "force-variants.zip",
    PUBLISHED / "telling-losses.zip",
    BUNDLES / "grating-grammar.zip",
)
LARGE = sorted({*PUBLISHED.glob("*.zip"), *BUNDLES.glob("*.zip")} - {*SMALL})

Change = Callable[[Members], Members]


def read(bundle: Path) -> subprocess.CompletedProcess[str]:
    """Run the reader in a Python that sees its own library alone."""
    command = [sys.executable, "-I", "-S", str(READER), str(bundle)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "bundle", [*SMALL, *(pytest.param(path, marks=pytest.mark.slow) for path in LARGE)], ids=lambda path: path.stem
)
def test_reader_finds_published_files_in_order(bundle: Path) -> None:
    """Of every release; its last two lines are the digests of the bundle and of the run."""
    done = read(bundle)
    assert (done.returncode, done.stderr) == (0, "")
    *_, of_bundle, of_run = done.stdout.splitlines()
    assert of_bundle == f"bundle digest: {read_bundle(bundle)[2]}"
    assert re.fullmatch("digest: [0-9a-f]{64}", of_run)
    if bundle.parent == PUBLISHED:
        page = (PUBLISHED / "README.md").read_text(encoding="utf-8")
        assert f"`{of_run.removeprefix('digest: ')}`" in page


@pytest.mark.parametrize("bundle", [SMALL[0], SMALL[2]], ids=["run", "sweep"])
def test_both_digests_are_those_of_a_replay(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Who has TacEvo and who has not cite the same."""
    assert main(["replay", str(bundle)]) == 0
    told = [line.partition(" (")[0] for line in capsys.readouterr().out.splitlines()]
    assert [line for line in read(bundle).stdout.splitlines()[-2:] if line not in told] == []


def refusal(bundle: Path) -> str:
    """Return the line that a bundle is refused with, without a trace of Python; empty where it is in order."""
    done = read(bundle)
    assert done.returncode in {0, 1}
    assert done.returncode == len(done.stderr.splitlines())
    assert done.stderr.startswith("different: ") or done.returncode == 0
    return done.stderr


def studied() -> Members:
    """Return the members of a run with a study whose predictions are kept."""
    return members_of(PUBLISHED / "grating-winners.zip")


def of_lines(name: str, number: int, change: Callable[[dict[str, Any]], object], *, digest: str = "") -> Change:
    """Change a line of a ledger; where a file is named that has the digest, make chain and digest anew."""

    def changed(members: Members) -> Members:
        (place,) = (one for one in members if re.fullmatch(name, one))
        previous, lines = GENESIS, []
        for index, text in enumerate(members[place].splitlines()):
            line = json.loads(text)
            if index == number:
                change(line)
            if digest:
                line, previous = seal({key: line[key] for key in line.keys() - {"previous", "hash"}}, previous)
            lines.append(f"{canonical(line)}\n")
        made = {**members, place: "".join(lines).encode()}
        if not digest:
            return made
        return of_json(digest, lambda record: record.update(digest=previous))(made)

    return changed


def of_json(name: str, change: Callable[[Any], object]) -> Change:
    """Change a file of JSON."""

    def changed(members: Members) -> Members:
        (place,) = (one for one in members if re.fullmatch(name, one))
        record = json.loads(members[place])
        change(record)
        return {**members, place: json.dumps(record, indent=1, ensure_ascii=False).encode()}

    return changed


def of_store(kind: str, change: Callable[[dict[str, Any]], object]) -> Change:
    """Change the first entry of a kind, and write all in their order; an entry that loses its kind is left out."""

    def changed(members: Members) -> Members:
        _, *lines = lzma.decompress(members["store.jsonl.xz"]).splitlines()
        entries = [json.loads(line) for line in lines]
        change(next(entry for entry in entries if entry["kind"] == kind))
        kept = sorted((entry["kind"], canonical(entry)) for entry in entries if "kind" in entry)
        text = "\n".join([canonical({"schema": 1, "entries": len(kept)}), *(line for _, line in kept)]) + "\n"
        return {**members, "store.jsonl.xz": lzma.compress(text.encode())}

    return changed


def without(name: str) -> Change:
    """Leave out the first member of such a name."""

    def changed(members: Members) -> Members:
        gone = next(one for one in members if re.fullmatch(name, one))
        return {one: data for one, data in members.items() if one != gone}

    return changed


def replaced(name: str, old: str, new: str) -> Change:
    """Replace a text in a member."""

    def changed(members: Members) -> Members:
        (place,) = (one for one in members if re.fullmatch(name, one))
        assert re.search(old.encode(), members[place])
        return {**members, place: re.sub(old.encode(), new.encode(), members[place], count=1)}

    return changed


def more(field: str) -> Callable[[Any], None]:
    """Add to a number of a record, or to the first of a list of numbers."""

    def change(record: Any) -> None:
        *way, last = field.split(".")
        for name in way:
            record = record[int(name) if isinstance(record, list) else name]
        key: Any = int(last) if isinstance(record, list) else last
        record[key] += 1

    return change


def other_bytes(entry: dict[str, Any]) -> None:
    """Change a number of an array."""
    data = bytearray(base64.b64decode(entry["answer"]["base64"]))
    data[0] ^= 1
    entry["answer"]["base64"] = base64.b64encode(data).decode()


def seal_of(line: dict[str, Any], previous: str) -> dict[str, Any]:
    """Return a line behind another one, with a hash that fits."""
    return seal({key: line[key] for key in line.keys() - {"previous", "hash"}}, previous)[0]


def better(entry: dict[str, Any]) -> None:
    """Lower the last loss of a full training, which then is the lowest."""
    entry["answer"]["full"]["training"]["validation_losses"][-1] = 1e-9


def answered_twice(members: Members) -> Members:
    """Add an entry with the question of another one."""
    _, *lines = lzma.decompress(members["store.jsonl.xz"]).splitlines()
    entry = next(one for line in lines if (one := json.loads(line))["kind"] == "evaluations")
    entry["answer"]["training"]["validation_losses"][0] += 1
    kept = sorted((json.loads(line)["kind"], line.decode()) for line in [*lines, canonical(entry).encode()])
    text = "\n".join([canonical({"schema": 1, "entries": len(kept)}), *(line for _, line in kept)]) + "\n"
    return {**members, "store.jsonl.xz": lzma.compress(text.encode())}


def first(members: Members, name: str) -> str:
    """Return the first member of such a file."""
    return next(one for one in sorted(members) if one.endswith(f"/{name}"))


LEDGER, SCORES, RUN, STUDY = "run/ledger.jsonl", r"run/studies/.*/scores\.jsonl", r"run/run\.json", r".*/study\.json"

#: Edits of `grating-winners` whose manifest was made anew, with what the reader names.
MENDED: dict[str, tuple[Change, str]] = {
    "a number in the ledger": (of_lines(LEDGER, 1, more("fitness")), f"{LEDGER}, line 2, g00s00, hash"),
    "a hash in the ledger": (of_lines(LEDGER, 1, lambda line: line.update(hash="0" * 64)), "line 2, g00s00, hash"),
    "a line's predecessor": (
        of_lines(LEDGER, 2, lambda line: line.update(seal_of(line, "0" * 64))),
        "line 3, g00s01, previous",
    ),
    "the ledger's last line gone": (replaced(LEDGER, r"[^\n]*\n\Z", ""), f"{RUN.replace(chr(92), '')}, digest"),
    "a fitness, its chain mended": (of_lines(LEDGER, 1, more("fitness"), digest=RUN), "line 2, g00s00, fitness"),
    "a loss, its chain mended": (
        of_lines(LEDGER, 1, more("validation_losses.0"), digest=RUN),
        "line 2, g00s00, validation_losses",
    ),
    "weights, their chain mended": (
        of_lines(LEDGER, 1, lambda line: line.update(weights="0" * 64), digest=RUN),
        "line 2, g00s00, weights",
    ),
    "a key, its chain mended": (
        of_lines(LEDGER, 1, lambda line: line.update(evaluation="0" * 64), digest=RUN),
        "line 2, g00s00",
    ),
    "a line that is no record": (replaced(LEDGER, r"\A[^\n]*", "[]"), f"{LEDGER}, line 1"),
    "another text of a line": (replaced(LEDGER, '":', '": '), f"{LEDGER}, line 1"),
    "a number that is none": (replaced(LEDGER, r'"fitness":[0-9.]+', '"fitness":NaN'), f"{LEDGER}, line 2"),
    "a key a second time": (replaced(LEDGER, r'"fitness":', '"fitness":0.1,"fitness":'), f"{LEDGER}, line 2"),
    "the run's digest": (of_json(RUN, lambda run: run.update(digest="0" * 64)), "run/run.json, digest"),
    "the run's data": (of_json(RUN, more("data.image_size")), "run/run.json, data"),
    "the run's task": (of_json(RUN, lambda run: run["task"].update(system="x")), "run/run.json, task"),
    "the run without a digest": (of_json(RUN, lambda run: run.pop("digest")), "run/run.json"),
    "an elite's fitness": (of_json(r"run/archive\.json", more("elites.0.fitness")), "run/archive.json, elites"),
    "an elite gone": (of_json(r"run/archive\.json", lambda one: one["elites"].pop()), "run/archive.json, elites"),
    "the coverage": (of_json(r"run/archive\.json", more("coverage")), "run/archive.json, coverage"),
    "a setting": (of_json(RUN, more("config.training.epochs")), "run/run.json, config.training"),
    "the run's seed": (of_json(RUN, more("config.seed")), "run/run.json, config.seed"),
    "a source": (replaced(r"run/candidates/g00s00\.py", "class", "klass"), "line 2, g00s00, source"),
    "a source gone": (without(r"run/candidates/g00s00\.py"), "line 2, g00s00, source"),
    "the archive gone": (without(r"run/archive\.json"), "run/archive.json"),
    "the scores gone": (without(SCORES), "scores.jsonl"),
    "a metric": (of_lines(SCORES, 1, more("metrics.accuracy")), "scores.jsonl, line 2, g00s00, hash"),
    "a metric, its chain mended": (
        of_lines(SCORES, 1, more("metrics.accuracy"), digest=STUDY),
        "scores.jsonl, line 2, g00s00, metrics",
    ),
    "a validation loss, its chain mended": (
        of_lines(SCORES, 2, more("validation_loss"), digest=STUDY),
        "scores.jsonl, line 3, g00s00, validation_loss",
    ),
    "an epoch, its chain mended": (of_lines(SCORES, 1, more("epoch"), digest=STUDY), "line 2, g00s00, epoch"),
    "a network's number, its chain mended": (of_lines(SCORES, 1, more("seed"), digest=STUDY), "scores.jsonl, rows"),
    "a confusion, its chain mended": (
        of_lines(SCORES, 1, more("confusion.0.0"), digest=STUDY),
        "line 2, g00s00, confusion",
    ),
    "the study's digest": (of_json(STUDY, lambda study: study.update(digest="0" * 64)), "study.json, digest"),
    "the study's seeds": (of_json(STUDY, more("seeds")), "study.json, seeds"),
    "the study's margin": (of_json(STUDY, more("terms.margin.value")), "study.json, terms"),
    "a network's fitness": (of_json(STUDY, more("networks.0.fitness")), "study.json, networks"),
    "a loss in the store": (
        of_store("evaluations", more("answer.training.validation_losses.0")),
        "validation_losses",
    ),
    "a question in the store": (of_store("evaluations", more("request.seed")), "evaluation"),
    "an entry with two answers": (answered_twice, "store.jsonl.xz, line"),
    "an entry gone": (of_store("evaluations", lambda entry: entry.pop("kind")), "evaluation"),
    "a metric in the store": (of_store("studies", more("answer.full.metrics.accuracy")), "metrics"),
    "a last loss of a study": (of_store("studies", better), "validation_loss"),
    "predictions in the store": (of_store("arrays", other_bytes), "store.jsonl.xz, line 2, base64"),
    "an array gone": (of_store("arrays", lambda entry: entry.pop("kind")), "scores.jsonl, line"),
    "a median in a table": (
        replaced(r"tables/scores_grating_[^/]*\.csv", r"(?m)^(baseline,[^,]*,[^,]*,[^,]*,0\.9)", r"\g<1>1"),
        ".csv, baseline, median",
    ),
}


@pytest.mark.parametrize("edit", MENDED)
def test_edits_are_found_behind_a_manifest_that_fits(edit: str, tmp_path: Path) -> None:
    """Another hash, or what follows from other records, finds them; the line names member, line and field."""
    change, words = MENDED[edit]
    assert words in refusal(zipped(honest(change(studied())), tmp_path / "x.zip"))


#: Edits of which the reader says what the manifest does.
LISTED: dict[str, tuple[Change, str]] = {
    "ledger": (of_lines(LEDGER, 1, more("fitness")), f"{LEDGER}, SHA-256"),
    "scores": (of_lines(SCORES, 1, more("metrics.accuracy")), "scores.jsonl, SHA-256"),
    "store": (of_store("evaluations", more("answer.training.validation_losses.0")), "store.jsonl.xz, SHA-256"),
    "table": (replaced(r"tables/costs_[^/]*\.csv", "[0-9]", "x"), ".csv, SHA-256"),
    "figure": (replaced("figures/seed_boxes.*pdf", "PDF", "pdf"), ".pdf, SHA-256"),
    "timings": (replaced(r".*/timings\.jsonl", "[0-9]", "x"), "run/timings.jsonl, SHA-256"),
    "README": (replaced(r"README\.md", "a", "b"), "README.md, SHA-256"),
    "missing": (without(r"tables/costs_.*"), "expected"),
    "manifest": (without(r"manifest-sha256\.txt"), "SHA-256"),
    "added": (lambda members: {**members, "run/more.txt": b"x"}, "run/more.txt, SHA-256"),
    "order": (replaced("manifest-sha256.txt", r"([^\n]*\n)([^\n]*\n)", r"\2\1"), "manifest-sha256.txt, text"),
    "twice": (replaced("manifest-sha256.txt", r"\A([^\n]*\n)", r"\1\1"), "manifest-sha256.txt, text"),
}


@pytest.mark.parametrize("edit", LISTED)
def test_edits_are_found_by_the_manifest(edit: str, tmp_path: Path) -> None:
    """Every member has its SHA-256 there, and no other member is there."""
    change, words = LISTED[edit]
    assert words in refusal(zipped(change(studied()), tmp_path / "x.zip"))


def test_second_member_of_a_name_is_found(tmp_path: Path) -> None:
    """A reader that takes the first of two, and one that takes the last, would see different files."""
    members = studied()
    bundle = zipped(members, tmp_path / "x.zip")
    with zipfile.ZipFile(bundle, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr(LEDGER, members[LEDGER])
    assert f"{LEDGER}, how often it is there" in refusal(bundle)


#: Edits of a sweep whose manifest was made anew.
OF_SWEEPS: dict[str, tuple[Change, str]] = {
    "a job gone": (of_json(r"sweep/sweep\.json", lambda sweep: sweep["jobs"].pop()), "sweep/sweep.json, jobs"),
    "a job's seed": (of_json(r"sweep/sweep\.json", more("jobs.0.seed")), "sweep/sweep.json"),
    "a run gone": (without(r"sweep/[^/]*/run\.json"), "sweep/sweep.json, jobs"),
    "a ledger in the store": (
        of_store("candidates", lambda entry: entry["request"].update(file="sweep/sweep.json")),
        "store.jsonl.xz, a file of its own",
    ),
    "a candidate's file": (of_store("candidates", lambda entry: entry["answer"].update(text="x")), "source"),
    "an answer": (of_store("completions", lambda entry: entry["answer"].update(text="x")), "answer"),
    "a question": (of_store("completions", more("request.draw")), "answer"),
    "tokens of an answer": (of_store("completions", more("answer.output_tokens")), "answer"),
    "a prompt": (
        lambda members: of_json(re.escape(first(members, "prompts.json")), more("trials.0.curiosity"))(members),
        "prompts.json, trials",
    ),
}


@pytest.mark.parametrize("edit", OF_SWEEPS)
def test_edits_of_sweeps_are_found(edit: str, tmp_path: Path) -> None:
    """As those of a run."""
    change, words = OF_SWEEPS[edit]
    members = members_of(PUBLISHED / "telling-losses.zip")
    assert words in refusal(zipped(honest(change(members)), tmp_path / "x.zip"))


#: Edits that docs/formats.md says are bound by the bundle digest alone.
UNFOUND: dict[str, Change] = {
    "timings": replaced(r".*/timings\.jsonl", r'"seconds":', '"seconds":1'),
    "a table without medians": replaced(r"tables/costs_[^/]*\.csv", "[0-9]", "x"),
    "versions": of_json(RUN, lambda run: run["versions"].update(torch="0")),
    "a profile": of_store("probes", lambda entry: entry["answer"]["profile"].update(modules=1)),
}


@pytest.mark.parametrize("edit", UNFOUND)
def test_what_the_page_says_is_not_found_has_another_bundle_digest(edit: str, tmp_path: Path) -> None:
    """Behind a manifest that fits, only the bundle digest of its authors speaks for these."""
    before = read(PUBLISHED / "grating-winners.zip").stdout.splitlines()
    after = read(zipped(honest(UNFOUND[edit](studied())), tmp_path / "x.zip")).stdout.splitlines()
    assert (after[-1], after[-2] == before[-2]) == (before[-1], False)


def test_name_in_a_file_begins_no_line(tmp_path: Path) -> None:
    """A member whose name has a line break cannot make a line that looks like a digest."""
    members = {**studied(), "run/x\ndigest: 00": b"x"}
    done = read(zipped(honest(members), tmp_path / "x.zip"))
    assert "digest: 00" not in (done.stdout + done.stderr).splitlines()
    assert len(done.stderr.splitlines()) == done.returncode


@pytest.mark.parametrize("data", [b"", b"no zip file"], ids=["empty", "text"])
def test_what_is_no_bundle_is_refused_in_a_line(data: bytes, tmp_path: Path) -> None:
    """So is a file that is not there."""
    (tmp_path / "x.zip").write_bytes(data)
    assert f"{tmp_path / 'x.zip'}: " in refusal(tmp_path / "x.zip")
    assert f"{tmp_path / 'y.zip'}: " in refusal(tmp_path / "y.zip")
