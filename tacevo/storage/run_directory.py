"""A run directory: what one run leaves behind, readable with `ls` and `cat`.

run.json        the resolved configuration, the task's texts, data facts, versions, machine, digest, and what
                held the candidates
ledger.jsonl    every decision, one line each (tacevo.storage.ledger)
timings.jsonl   wall times and costs, which no ledger may hold
archive.json    the network archive, niche by niche
prompts.json    the prompt archive
candidates/     the source of every admitted candidate, and the answer and the reason behind every rejected one
summary.md      what was found
"""

import contextlib
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from tacevo.costs import Spending
from tacevo.errors import RunError, TacevoError
from tacevo.records import Json, Rejection
from tacevo.storage.canonical import canonical, content_hash, readable
from tacevo.storage.files import locked, sweep, write_durably
from tacevo.storage.ledger import read_ledger

#: Layout of run.json.
SCHEMA = 1

#: A candidate's file holds its source, or the answer that was rejected.
_ENDINGS = {".py", ".rejected.txt"}

#: What the ledger's hash of the prompt archive covers of a trial.
_TRIAL = ("prompt", "temperature", "inserted", "curiosity")


class RunDirectory:
    """Writes and reads the files of one run.

    Args:
        path: the folder; made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def ledger(self) -> Path:
        """The ledger's path."""
        return self.path / "ledger.jsonl"

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the directory for this process alone; a killed process lets go of it by itself.

        Raises:
            RunError: another process is at work in it, or the folder cannot be made.
        """
        with locked(self.path, "run.dir"):
            yield

    @property
    def is_busy(self) -> bool:
        """Whether a process holds the directory at this moment."""
        try:
            handle = os.open(self.path / ".lock", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return False
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            return False
        else:
            return False
        finally:
            os.close(handle)

    def sweep(self) -> None:
        """Remove what killed writers left here."""
        sweep(self.path)

    def write_json(self, name: str, value: Json) -> None:
        """Write one of the JSON files whole."""
        write_durably(self.path / name, readable(value))

    def write_text(self, name: str, text: str) -> None:
        """Write one of the text files whole."""
        write_durably(self.path / name, text)

    def read_run(self) -> dict[str, Json]:
        """Read run.json.

        Raises:
            RunError: this is no run directory, or one of another layout.
        """
        path = self.path / "run.json"
        try:
            run: dict[str, Json] = json.loads(path.read_text(encoding="utf-8"))
            schema = run["schema"]
        except FileNotFoundError as error:
            raise RunError(f"{self.path} is not the folder of a run: it has no run.json") from error
        except NotADirectoryError as error:
            raise RunError(
                f"{self.path} is a file, and this takes the folder of a run; unpack a published one, and give its run/"
            ) from error
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise RunError(
                f"{path} is damaged: {type(error).__name__}: {error}; restore it, or delete it, and the "
                "`tacevo search` command that began the run writes it anew"
            ) from error
        if schema != SCHEMA:
            raise RunError(f"{path} has schema {schema!r}; this version of tacevo reads {SCHEMA}")
        return run

    @contextlib.contextmanager
    def believed(self) -> Iterator[None]:
        """Use what was read from here; a field that is missing or of another type is the directory's fault.

        Raises:
            RunError: the directory is damaged.
        """
        try:
            yield
        except TacevoError:
            raise
        except (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError) as error:
            raise RunError(f"{self.path} is damaged: {type(error).__name__}: {error}") from error

    def read_ledger(self) -> tuple[dict[str, Json], ...]:
        """Read the ledger, checked (`tacevo.storage.ledger.read_ledger`)."""
        return read_ledger(self.ledger)

    def finished_digest(self) -> str | None:
        """Give the digest of a finished run; None where none was begun here, or the run did not come to its end.

        A run is finished where run.json has the digest that the ledger ends with, whoever brought it there.

        Raises:
            RunError: something of it was damaged or edited.
        """
        if not (self.path / "run.json").exists():
            return None
        digest = self.read_run().get("digest")
        if digest is None:
            return None
        lines = self.read_ledger()
        return str(digest) if lines and lines[-1]["hash"] == digest else None

    def read_finished(self) -> tuple[dict[str, Json], ...]:
        """Read the ledger of a finished run.

        Raises:
            RunError: it is not finished, or something of it was damaged or edited.
        """
        lines = self.read_ledger()
        if not lines or self.read_run().get("digest") != lines[-1]["hash"]:
            raise RunError(
                f"{self.path} is not finished, or its digest was edited; the command that began it continues it"
            )
        return lines

    def begin_with(self, lines: Sequence[dict[str, Json]]) -> None:
        """Let the ledger begin with the lines of another run's; one that stands here must begin with them already.

        Raises:
            RunError: it does not.
        """
        standing = self.read_ledger() if self.ledger.exists() else ()
        if not standing:
            write_durably(self.ledger, "".join(f"{canonical(line)}\n" for line in lines))
        elif len(standing) < len(lines) or standing[len(lines) - 1]["hash"] != lines[-1]["hash"]:
            raise RunError(f"run.dir={self.path} holds another run, or less of this one; choose another run.dir")

    def read_elites(self) -> list[str]:
        """Read the ids of the network archive's elites, as `read_niches` does."""
        return list(self.read_niches().values())

    def read_niches(self) -> dict[int, str]:
        """Read the ids of the network archive's elites, by niche; none before the first generation is complete.

        Raises:
            RunError: the file is damaged.
        """
        path = self.path / "archive.json"
        try:
            elites = json.loads(path.read_text(encoding="utf-8"))["elites"]
            return {elite["niche"]: elite["id"] for elite in elites}
        except FileNotFoundError:
            return {}
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise RunError(f"{path} is damaged: {type(error).__name__}: {error}") from error

    def read_archives(self, ledger: Sequence[Mapping[str, Json]]) -> tuple[dict[str, Json], dict[str, Json]]:
        """Read archive.json and prompts.json of a finished run, held against the last generation of its ledger.

        Args:
            ledger: see `read_finished`.

        Raises:
            RunError: a file is missing, or is not what the ledger says: its occupants of the niches, or its bounds.
        """
        archive, prompts = self._read_json("archive.json"), self._read_json("prompts.json")
        with self.believed():
            last = next(line for line in reversed(ledger) if line["kind"] == "generation")
            elites = [
                (entry["niche"], {"name": entry["id"], "objective": -entry["fitness"]}) for entry in archive["elites"]
            ]
            trials = [(entry["niche"], {name: entry[name] for name in _TRIAL}) for entry in prompts["trials"]]
            if not _is_recorded(elites, last["archive"]) or archive["bounds"] != last["bounds"]:
                raise self._edited("archive.json")
            if not _is_recorded(trials, last["prompt_archive"]):
                raise self._edited("prompts.json")
        return archive, prompts

    def keep_candidate(self, name: str, source: str) -> None:
        """Keep the source of an admitted candidate."""
        self._keep(name, ".py", source)

    def keep_rejected(self, name: str, rejection: Rejection, answer: str) -> None:
        """Keep the answer behind a rejected candidate, under the reason."""
        self._keep(name, ".rejected.txt", rejected_text(rejection, answer))

    def read_kept(self, name: str) -> str | None:
        """Read a candidate's file, of either kind; None where there is none."""
        for ending in _ENDINGS:
            path = self.path / "candidates" / f"{name}{ending}"
            if path.exists():
                return path.read_text(encoding="utf-8", errors="replace")
        return None

    def read_source(self, name: str, sha256: str) -> str:
        """Read the source of an admitted candidate.

        Args:
            name: its id.
            sha256: of the source, as its ledger line has it.

        Raises:
            RunError: the file is missing, or is not what was admitted.
        """
        source = self.read_kept(name)
        if source is None or hashlib.sha256(source.encode()).hexdigest() != sha256:
            raise RunError(f"{self.path}/candidates/{name}.py is missing or was edited; restore the file")
        return source

    def _read_json(self, name: str) -> dict[str, Json]:
        try:
            value: dict[str, Json] = json.loads((self.path / name).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError, RecursionError) as error:
            raise self._edited(name) from error
        return value

    def _edited(self, name: str) -> RunError:
        return RunError(
            f"{self.path / name} is missing, damaged or edited: it is not what the ledger ends with; the command that "
            "began the run writes it anew"
        )

    def _keep(self, name: str, ending: str, text: str) -> None:
        """Write a candidate's file unless it stands there; one of another kind was left by a killed run."""
        folder = self.path / "candidates"
        for other in _ENDINGS - {ending}:
            (folder / f"{name}{other}").unlink(missing_ok=True)
        path = folder / f"{name}{ending}"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_durably(path, text)

    def add_timing(self, entry: dict[str, Json]) -> None:
        """Append a line to timings.jsonl, with the present time; a line torn by a kill is ended first.

        Raises:
            RunError: the disk is full or fails.
        """
        line = json.dumps({**entry, "at": datetime.now(UTC).isoformat(timespec="milliseconds")}) + "\n"
        path = self.path / "timings.jsonl"
        try:
            with path.open("ab+") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
                torn = file.read(1) not in (b"", b"\n")
                file.write(f"\n{line}".encode() if torn else line.encode())
        except OSError as error:
            raise RunError(
                f"{path} cannot be written: {error.strerror}; the ledger is safe. Make room, and run the same command "
                "again"
            ) from error

    def read_spending(self) -> dict[str, Spending]:
        """Read what each candidate's answers cost, by id; a line torn by a kill is left out."""
        path = self.path / "timings.jsonl"
        spent: dict[str, Spending] = {}
        for text in path.read_bytes().splitlines() if path.exists() else ():
            with contextlib.suppress(ValueError, TypeError, AttributeError, ArithmeticError, RecursionError):
                entry = json.loads(text)
                if "id" in entry:
                    spent[entry["id"]] = Spending.from_json(entry)
        return spent


def _is_recorded(occupants: Sequence[tuple[int, Json]], recorded: str) -> bool:
    """Tell whether these occupants of niches have the hash that a ledger gives them."""
    by_niche = {str(niche): occupant for niche, occupant in occupants}
    try:
        return len(by_niche) == len(occupants) and content_hash(by_niche) == recorded
    except ValueError:  # NaN, which JSON cannot hold and Python's reader lets through
        return False


def rejected_text(rejection: Rejection, answer: str) -> str:
    """Write the answer behind a rejected candidate, under the reason."""
    return f"{rejection.stage}: {rejection.reason}: {rejection.detail}\n{'-' * 72}\n{answer}\n"
