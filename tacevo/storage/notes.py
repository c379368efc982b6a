"""The note in which the makers of a run or a sweep tell its readers what to know: the file NOTE.md of its directory."""

from pathlib import Path

from tacevo.errors import RunError

NOTE = "NOTE.md"

#: The heading above a note wherever it is shown.
HEADING = "## What readers must know"

#: Characters that a note may have: it stands above a report and in the metadata of a bundle.
LONGEST = 5_000

_EXPECTED = f"at most {LONGEST:,} characters"


def read_note(directory: Path) -> tuple[str, ...]:
    """Read the paragraphs of a note, without their line breaks; none where there is no note.

    Each item of a list, `- ...`, is a paragraph.

    Raises:
        RunError: it is not text in UTF-8, or too long.
    """
    path = directory / NOTE
    if not path.is_file() or path.is_symlink():  # a stranger's run must not show a file of this user
        return ()
    if path.stat().st_size > LONGEST * 4:  # bytes, of which UTF-8 has four for a character at most
        raise RunError(f"{path.stat().st_size:,} bytes", place=str(path), expected=_EXPECTED, remedy="shorten it")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise RunError(str(error), place=str(path), expected="text in UTF-8") from error
    if len(text) > LONGEST:
        raise RunError(f"{len(text):,}", place=str(path), expected=_EXPECTED, remedy="shorten it")
    blocks = f"\n{text}".replace("\n- ", "\n\n").split("\n\n")
    return tuple(words for block in blocks if (words := " ".join(block.split())))
