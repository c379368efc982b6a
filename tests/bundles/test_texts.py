"""Promise: of all texts with one value, a replay accepts the one that was recorded, in every file of a bundle."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from bundles import Members, Refused, members_of, resealed
from commands import publish
from refusals import refused as refusing

from tacevo.bundles.open import opened
from tacevo.bundles.texts import check_texts
from tacevo.cli.app import main
from tacevo.errors import BundleError, TacevoError
from tacevo.results.study_directory import studies_of
from tacevo.storage.canonical import readable
from tacevo.storage.run_directory import MANIFEST
from tacevo.storage.zipfiles import packed

GOLDEN = Path(__file__).parents[1] / "golden" / "bundles"

Rewrite = Callable[[str], str]


@pytest.fixture
def whole(published: Path) -> Members:
    """Return the members of a sound bundle."""
    return members_of(published / "run.zip")


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Replay bundles in a directory of the test's own."""
    return Refused(tmp_path, capsys)


def twice(text: str) -> str:
    """Put another value of the first key before the true one."""
    return re.sub(r'\{(\s*)("\w+"|"@\w+")', r"{\1\2: 0.0001,\1\2", text, count=1)


def twice_within(text: str) -> str:
    """Put another value of the last key before the true one, under an escaped spelling of its name."""
    keys = list(re.finditer(r'"(\w)(\w+)"(: ?)', text))
    if not keys:
        return text
    last = keys[-1]
    other = f'"\\u{ord(last[1]):04x}{last[2]}"{last[3]}0.0001,'
    return f"{text[: last.start()]}{other}{text[last.start() :]}"


def turned(text: str) -> str:
    """Turn the order of the keys of the first object that has two or more."""
    if text.count("\n") > 1 and text.startswith("{\n"):
        return readable(dict(reversed(json.loads(text).items())))
    first, end, rest = text.partition("\n")
    return f"{canonical_backwards(first)}{end}{rest}"


def canonical_backwards(line: str) -> str:
    """Write a line with its keys in the opposite order."""
    return json.dumps(dict(reversed(json.loads(line).items())), separators=(",", ":"), ensure_ascii=False)


REWRITES: dict[str, Rewrite] = {
    "key twice": twice,
    "last key twice": twice_within,
    "other order": turned,
    "space": lambda text: text.replace('": ', '" : ', 1) if '": ' in text else text.replace('":', '": ', 1),
    "trailing zero": lambda text: re.sub(r"([:,] ?\d+\.\d+)(?=[,}\n])", r"\g<1>0", text, count=1),
    "exponent": lambda text: re.sub(r"([:,] ?\d+\.\d+)(?=[,}\n])", r"\g<1>e0", text, count=1),
    "escape": lambda text: re.sub(r'"([a-z])(\w*)":', lambda key: f'"\\u{ord(key[1]):04x}{key[2]}":', text, count=1),
    "empty line": lambda text: f"{text}\n",
    "no last line feed": lambda text: text.removesuffix("\n"),
    "other line ends": lambda text: text.replace("\n", "\r\n"),
    "mark": lambda text: f"\ufeff{text}",
    "torn line": lambda text: f'{text}{{"fitness":0.0001',
}

FILES = ["ledger.jsonl", "archive.json", "prompts.json", "run.json", "timings.jsonl", "study.json", "scores.jsonl"]


def member(members: Members, name: str) -> str:
    """Return the full name of the first member of a name."""
    return next(full for full in members if full.rpartition("/")[2] == name)


def read_texts(bundle: Path) -> None:
    """Read the run of a bundle and its studies, and compare their texts."""
    place = opened(bundle)
    check_texts(place.read(place.folder), [study.read_scores() for study in studies_of(place.folder)])


def place_of_refusal(members: Members, target: Path) -> str:
    """Return where members with checksums made anew are refused."""
    with pytest.raises(TacevoError) as caught:
        read_texts(resealed(members, target))
    return caught.value.place


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [*FILES, "ro-crate-metadata.json"])
def test_other_text_of_the_same_value_is_refused(name: str, whole: Members, tmp_path: Path) -> None:
    """Whatever the way, with all checksums anew, and the member is named."""
    full = member(whole, name)
    text = whole[full].decode()
    changed = {way: new for way, rewrite in REWRITES.items() if (new := rewrite(text)) != text}
    assert len(changed) >= len(REWRITES) - 2  # some files have no fraction
    for way, new in changed.items():
        is_shorter = (name, way) == ("ledger.jsonl", "no last line feed")  # as if a crash had torn its last line
        assert ("x.zip" if is_shorter else name) in place_of_refusal({**whole, full: new.encode()}, tmp_path / "x.zip")


@pytest.mark.parametrize("way", ["key twice", "other order", "trailing zero"])
def test_replay_refuses_a_text_that_was_not_recorded(way: str, whole: Members, refused: Refused) -> None:
    """Where all values are those of the search."""
    for name in ("ledger.jsonl", "scores.jsonl", "archive.json", "run.json"):
        full = member(whole, name)
        refused({**whole, full: REWRITES[way](whole[full].decode()).encode()}, name)


def values_of(text: str) -> list[object]:
    """Return what a JSON reader makes of a file or of its lines."""
    try:
        return [json.loads(text)]
    except json.JSONDecodeError:
        return [json.loads(line) for line in text.splitlines()]


def test_rewrites_leave_the_value(whole: Members) -> None:
    """Else other checks would refuse them, and the test above would show nothing."""
    for name in FILES:
        text = whole[member(whole, name)].decode()
        for way in ("key twice", "last key twice", "other order", "space", "trailing zero", "exponent", "escape"):
            assert values_of(REWRITES[way](text)) == values_of(text), (name, way)


@pytest.mark.few(1)
@pytest.mark.parametrize("way", ["key twice", "other order", "space", "no last line feed"])
def test_files_of_the_first_releases_keep_to_their_own_form(way: str, tmp_path: Path) -> None:
    """They lack later settings, wrote times with spaces and a study's name first; nothing else of them is free."""
    whole = members_of(GOLDEN / "force-grammar.zip")
    assert "pages" not in json.loads(whole["run/run.json"])
    for full in ("run/run.json", "run/timings.jsonl", member(whole, "study.json")):
        new = REWRITES[way](whole[full].decode())
        assert new != whole[full].decode()
        assert full.rpartition("/")[2] in place_of_refusal({**whole, full: new.encode()}, tmp_path / "x.zip")


def test_settings_of_run_json_keep_their_order(whole: Members, tmp_path: Path) -> None:
    """At any depth."""
    run = json.loads(whole["run/run.json"])
    config = {**run["config"], "search": dict(reversed(run["config"]["search"].items()))}
    text = readable({**run, "config": config}).encode()
    assert "run.json, line " in place_of_refusal({**whole, "run/run.json": text}, tmp_path / "x.zip")


def test_unknown_fact_is_no_fault(whole: Members, tmp_path: Path) -> None:
    """Later releases may record more of a machine."""
    run = json.loads(whole["run/run.json"])
    more = {**run, "versions": {"another": "1.0", **run["versions"]}}
    assert main(["replay", str(resealed({**whole, "run/run.json": readable(more).encode()}, tmp_path / "x.zip"))]) == 0


def test_manifest_has_one_form(whole: Members, tmp_path: Path) -> None:
    """Its SHA-256 is the bundle's digest, so equal members have one."""
    text = whole[MANIFEST].decode()
    lines = text.splitlines(keepends=True)
    bundle = tmp_path / "x.zip"
    for other in ("".join(reversed(lines)), text.replace("\n", "\r\n"), text[:-1], text.replace("\n", "\x0b")):
        bundle.write_bytes(packed({**whole, MANIFEST: other.encode()}))
        with refusing(BundleError, place=MANIFEST):
            opened(bundle)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("title: ", "title: A better run\ntitle: "),
        ("title: ", "title:  "),
        ("message: ", "# a remark\nmessage: "),
        ("type: dataset", 'type: "dataset"'),
        ("license: ", "? license\n: "),
    ],
)
def test_citation_has_one_form(old: str, new: str, whole: Members, tmp_path: Path) -> None:
    """Programs that cite read the last of two titles, or the first."""
    text = whole["CITATION.cff"].decode()
    edited = text.replace(old, new, 1)
    assert edited != text
    bundle = resealed({**whole, "CITATION.cff": edited.encode()}, tmp_path / "x.zip")
    with refusing(BundleError, place="CITATION.cff"):
        opened(bundle)


def test_long_citation_is_not_parsed(whole: Members, tmp_path: Path) -> None:
    """A reader of YAML takes a minute for what a member may hold."""
    bundle = resealed({**whole, "CITATION.cff": b"- a\n" * 1_000_000}, tmp_path / "x.zip")
    with refusing(BundleError, place="CITATION.cff", expected="at most 100000"):
        opened(bundle)


def test_candidates_file_with_other_line_ends_is_refused(whole: Members, refused: Refused) -> None:
    """Text that reads as the same lines is another text."""
    name = member(whole, "g00s00.py")
    refused({**whole, name: whole[name].replace(b"\n", b"\r\n")}, "g00s00.py: expected the text that was judged")


@pytest.mark.slow
def test_lines_that_a_kill_tore_are_not_published(folder: Path, tmp_path: Path) -> None:
    """Times are appended without care; a bundle holds whole lines only, and its replay accepts no other."""
    timings = folder / "run" / "timings.jsonl"
    first, *others = timings.read_text().splitlines(keepends=True)
    timings.write_text("".join([first[:30] + "\n", first, *others]))
    publish("run", "-o", "x.zip")
    assert members_of(tmp_path / "x.zip")["run/timings.jsonl"].decode() == "".join([first, *others])
    assert main(["replay", "x.zip"]) == 0
