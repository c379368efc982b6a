"""The files of a study, in `RUN/studies/<name>/`, readable with `ls` and `cat`.

study.json     what was studied, under which recipe, versions and machine; the digest once it is finished
scores.jsonl   a header, then a line for each network and seed in a fixed order, sealed as a ledger is

Both are written whole, so that several processes may end the same study at once: they write equal bytes.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.storage.canonical import canonical, content_hash, readable
from tacevo.storage.files import sweep, write_durably
from tacevo.storage.ledger import GENESIS, Ledger, is_sealed

#: Layout of both files.
SCHEMA = 2

#: What `name_study` gives, as a regular expression.
NAME = r"elites\d+-seeds\d+-epochs\d+-[0-9a-f]{8}"


class StudyDirectory:
    """Writes and reads the files of one study.

    Args:
        path: the folder; made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def scores(self) -> Path:
        """The path of the scores."""
        return self.path / "scores.jsonl"

    def begin(self, description: dict[str, Json], circumstances: dict[str, Json]) -> None:
        """Write study.json, unless it describes this very study already.

        Args:
            description: what decides the scores.
            circumstances: what else a reader wants to know.
        """
        sweep(self.path)
        if not describes(self._read(), description):
            self._write({"schema": SCHEMA, "name": self.path.name, **description, **circumstances, "digest": None})

    def finish(self, entries: Sequence[dict[str, Json]]) -> str:
        """Write the scores, or hold them against those that stand here; return the digest.

        Args:
            entries: the header, then the scores in their order.

        Raises:
            DivergenceError: the study was finished with other scores; the message names the row.
            RunError: the scores that stand here were damaged or edited.
        """
        if self.scores.exists():
            digest = self.compare(entries)
        else:
            with Ledger(None) as ledger:
                lines = [canonical(ledger.commit(entry)) for entry in entries]
            write_durably(self.scores, "\n".join(lines) + "\n")
            digest = ledger.digest
        self._write({**self.read(), "digest": digest})
        return digest

    def compare(self, entries: Sequence[dict[str, Json]]) -> str:
        """Hold the recorded scores against computed ones; return the digest.

        Raises:
            DivergenceError: they differ; the message names the row.
            RunError: the recorded ones were damaged or edited.
        """
        with Ledger(None, self.read_scores()) as ledger:
            for entry in entries:
                ledger.commit(entry)
        return ledger.digest

    def read(self) -> dict[str, Json]:
        """Read study.json.

        Raises:
            RunError: it is missing, damaged or of another layout.
        """
        study = self._read()
        if study is None:
            raise RunError(f"{self.path} is not the folder of a study: it has no sound study.json")
        if study.get("schema") != SCHEMA:
            raise RunError(
                f"{self.path}/study.json has schema {study.get('schema')!r}; this version reads {SCHEMA}. "
                f"Delete {self.path}; `tacevo study` writes it anew from the store"
            )
        return study

    def read_scores(self) -> tuple[dict[str, Json], ...]:
        """Read the header and the scores of a finished study, checked line by line.

        Raises:
            RunError: the study is not finished, or a line was damaged or edited; the message names network and seed.
        """
        texts = self.scores.read_bytes().splitlines() if self.scores.exists() else []
        if not texts:
            raise RunError(f"{self.path} is not finished: it has no scores.jsonl; `tacevo study` continues it")
        lines: list[dict[str, Json]] = []
        previous = GENESIS
        for number, text in enumerate(texts):
            line = _checked(text, previous)
            if line is None:
                raise RunError(
                    f"{self.scores}, {_row(lines, number)}: the line does not match its hash: it, or the one before "
                    f"it, was edited or damaged; delete {self.path}, and `tacevo study` writes it anew from the store"
                )
            lines.append(line)
            previous = line["hash"]
        return tuple(lines)

    def _read(self) -> dict[str, Json] | None:
        """Read study.json; None where it is missing or damaged."""
        try:
            study = json.loads((self.path / "study.json").read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError, RecursionError):
            return None
        return study if isinstance(study, dict) else None

    def _write(self, study: dict[str, Json]) -> None:
        write_durably(self.path / "study.json", readable(study))


def name_study(header: Mapping[str, Json], *, epochs: int) -> str:
    """Name the folder of a study after what it is; see `NAME`.

    Args:
        header: the first line of its scores.
        epochs: of its trainings.
    """
    return f"elites{len(header['networks']) - 1}-seeds{header['seeds']}-epochs{epochs}-{content_hash(header)[:8]}"


def studies_of(run: Path) -> list[StudyDirectory]:
    """List the studies of a run, finished or not, by name."""
    return [StudyDirectory(path.parent) for path in sorted(run.glob("studies/*/study.json"))]


def describes(study: dict[str, Json] | None, description: dict[str, Json]) -> bool:
    """Tell whether a study.json, if there is one, says all of a description."""
    return study is not None and all(study.get(key) == value for key, value in description.items())


def _checked(text: bytes, previous: str) -> dict[str, Json] | None:
    """Parse a line; None where it does not match its hash."""
    try:
        line: dict[str, Json] = json.loads(text)
        return line if is_sealed(line, previous) else None
    except (ValueError, AttributeError, TypeError, RecursionError):
        return None


def _row(lines: Sequence[dict[str, Json]], number: int) -> str:
    """Name the row of a line by its place: networks one after the other, each with all seeds."""
    if number == 0:
        return "the header"
    try:
        network, seed = divmod(number - 1, lines[0]["seeds"])
        return f"{lines[0]['networks'][network]['name']}, seed {seed}"
    except (LookupError, TypeError, ArithmeticError):  # of a header that no study has
        return f"line {number + 1}"
