"""Whether a published run's files are, byte for byte, the text that a release of this package writes of their content.

Of two texts with one value, only one was recorded. Another reader may take another value of the other one (of two equal
keys, say, the first), so what is merely equal in value is refused. Values are compared elsewhere (`verify`).
"""

import json
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from pathlib import Path

import yaml

from tacevo.bundles.readme import yaml_text
from tacevo.config.plain import from_plain
from tacevo.config.removed import with_removed
from tacevo.config.strict_yaml import read_yaml
from tacevo.errors import BundleError
from tacevo.evolution.run_files import NETWORKS, PROMPTS, read_archive_files
from tacevo.records import Json, to_json, written
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import FinishedStudy, plain_study
from tacevo.storage.canonical import readable
from tacevo.storage.ledger import sealed_text
from tacevo.storage.run_directory import Timing, timing_text
from tacevo.typed import UncheckedJson, parse

#: The citation is a few kB; YAML takes seconds for a megabyte.
_LONGEST_CITATION = 100_000


def check_texts(run: RecordedRun, studies: Iterable[FinishedStudy]) -> None:
    """Compare the files of a published run, whose values were compared, with the text that is written of them.

    Raises:
        BundleError: one is another text.
    """
    folder = run.directory.path
    _compare(run.directory.ledger, sealed_text(run.ledger.lines)[0])
    for name, file in zip((NETWORKS, PROMPTS), read_archive_files(run.directory), strict=True):
        _compare(folder / name, readable(written(file)))
    config = with_removed(to_json(from_plain(run.record.config)), run.record.config)
    _compare(folder / "run.json", _as_written({**to_json(run.record), "config": config}, folder / "run.json"))
    _check_timings(folder / "timings.jsonl")
    for study in studies:
        _compare(study.path / "scores.jsonl", sealed_text([study.header, *study.rows])[0])
        plain, path = plain_study(study.record), study.path / "study.json"
        early = {name: plain[name] for name in ("schema", "name")} | plain  # the order of a study without `rules`
        _compare(path, _as_written(early if "rules" not in _read(path) else plain, path))


def check_papers(folder: Path) -> None:
    """Compare the form of the metadata and the citation of a bundle with what is written of their content.

    Raises:
        BundleError: one has another form, e.g. a key twice.
    """
    metadata, citation = folder / "ro-crate-metadata.json", folder / "CITATION.cff"
    _compare(metadata, f"{json.dumps(_read(metadata), indent=1, sort_keys=True, ensure_ascii=False)}\n")
    if citation.stat().st_size > _LONGEST_CITATION:
        got = f"{citation.stat().st_size} bytes"
        raise BundleError(got, place=str(citation), expected=f"at most {_LONGEST_CITATION}")
    try:
        content = read_yaml(citation.read_text(encoding="utf-8"))
        _compare(citation, yaml_text(content))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BundleError(str(error), place=str(citation), expected="YAML, as `tacevo publish` writes it") from error


def _read(path: Path) -> dict[str, Json]:
    return parse(dict[str, UncheckedJson], path.read_bytes(), place=str(path), error=BundleError)


def _as_written(plain: Mapping[str, Json], path: Path) -> str:
    """Return the text of what run.json or study.json holds; a setting that came after its release is not in it."""
    return readable(_present(plain, _read(path)))


def _present(plain: Json, recorded: Json) -> Json:
    """Return a value without the fields that its text lacks, which are at their defaults."""
    if isinstance(plain, Mapping) and isinstance(recorded, Mapping):
        return {name: _present(value, recorded[name]) for name, value in plain.items() if name in recorded}
    if isinstance(plain, list) and isinstance(recorded, list):
        return [_present(*pair) for pair in zip(plain, recorded, strict=True)]
    return plain


def _check_timings(path: Path) -> None:
    """Compare each line; the first releases wrote them with spaces, in the order of the fields."""
    texts = []
    for number, line in enumerate(path.read_bytes().splitlines() if path.exists() else (), start=1):
        timing = parse(Timing, line, place=f"{path}, line {number}", error=BundleError)
        early = json.dumps(written(timing))
        texts.append(f"{early}\n" if line == early.encode() else timing_text(timing))
    if texts:
        _compare(path, "".join(texts))


def _compare(path: Path, text: str) -> None:
    """Compare a file with the text of its content."""
    recorded, made = path.read_bytes(), text.encode()
    if recorded == made:
        return
    pairs = enumerate(zip_longest(recorded.split(b"\n"), made.split(b"\n")), start=1)
    number = next(number for number, (was, now) in pairs if was != now)
    expected = "the text that `tacevo publish` writes of its content"
    raise BundleError(
        "another text of the same content: it was edited", place=f"{path}, line {number}", expected=expected
    )
