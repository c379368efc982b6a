"""The rows for docs/scale.md, from the files that `benchmarks/on_a_gpu.sh OUT` left; needs no GPU.

    python -m benchmarks.gpu_rows OUT

It prints the tables of the benchmarks as they stand, and one of what is to be compared with the goals. A figure whose
file is missing, or whose part failed, is `not measured`.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from tacevo.text import table

#: What a study of 5 networks, 20 seeds and 50 epochs trains on, and what the one of the script does: of 800 images.
_STUDY_IMAGES, _STUDY_TRAINED = 5 * 20 * 50 * 2400, 5 * 2 * 5 * 800
_ABSENT = "not measured"


def tables(text: str) -> list[list[dict[str, str]]]:
    """Read each table in a text: its rows, by the names of their columns."""
    found: list[list[dict[str, str]]] = []
    head: list[str] = []
    for line in text.splitlines():
        if not line.startswith("|"):
            head = []
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not head:
            head = cells
            found.append([])
        elif set("".join(cells)) - set("-: "):
            found[-1].append(dict(zip(head, cells, strict=True)))
    return found


def rates(rows: Sequence[dict[str, str]]) -> dict[tuple[str, str], tuple[float, float]]:
    """Return images/s of the eager loop and of the faster captured one, by network and precision."""
    return {
        (row["network"], row["precision"]): (
            _number(row["eager"]),
            max(_number(value) for name, value in row.items() if name.startswith("captured")),
        )
        for row in rows
        if "eager" in row and any(name.startswith("captured") for name in row)
    }


def goals(files: dict[str, str]) -> list[list[str]]:
    """Return a row for each figure that has a goal: what it is, the goal, and what was measured."""
    bench = [row for rows in tables(files.get("bench", "")) for row in rows]
    known = rates(bench)
    small = min((name for name in known if name[1] == "tf32"), key=lambda name: -known[name][1], default=("", ""))
    return [
        ["captured by eager, baseline, tf32", "1.25", _ratio(known, ("baseline", "tf32"))],
        [f"captured by eager, the fastest network ({small[0] or 'none'}), tf32", "3", _ratio(known, small)],
        ["start of a process with libraries mapped, s", "0.3", _start(files.get("start", ""))],
        [
            "the paper's search in tf32, each step run eagerly, two at once, h",
            "",
            _hours(files.get("estimate-before", "")),
        ],
        ["the same, captured, as many at once as fit, h", "1.5", _hours(files.get("estimate", ""))],
        ["a study of 5 networks x 20 seeds x 50 epochs, h", "2", _study(files)],
        ["candidates/h of a search of 61 at 256 px (800 images, 5 epochs)", "", _candidates(files)],
        ["trainings that --retrain repeated", "5 of 5", _retrained(files.get("retrain", ""))],
        ["1 worker, and 3 after a kill", "equal bytes", _killed(files.get("killed", ""))],
        ["confinement of a candidate", "kernel", _level(files.get("walls", ""))],
    ]


def _number(text: str) -> float:
    return float(text.replace(",", ""))


def _hours(text: str) -> str:
    said = re.search(r"hours: about ([\d.,]+)", text)
    return said[1] if said else _ABSENT


def _ratio(known: dict[tuple[str, str], tuple[float, float]], name: tuple[str, str]) -> str:
    if name not in known:
        return _ABSENT
    eager, captured = known[name]
    return f"{captured / eager:.2f} ({eager:,.0f} and {captured:,.0f} images/s)"


def _start(text: str) -> str:
    rows = [row for rows in tables(text) for row in rows]
    return f"{rows[-1]['in all']} ({rows[0]['in all']} without)" if len(rows) == 2 else _ABSENT


def _took(text: str) -> int | None:
    seconds = re.findall(r"^took (\d+) s$", text, re.MULTILINE)
    return int(seconds[-1]) if seconds else None


def _has_ended(files: dict[str, str], part: str) -> bool:
    """Return whether a part was there and did not fail."""
    failed = re.findall(r"^failed: (.*)$", files.get("versions", ""), re.MULTILINE)
    return part in files and bool(failed) and part not in failed[-1].split()


def _study(files: dict[str, str]) -> str:
    seconds = _took(files.get("study", ""))
    if not seconds or not _has_ended(files, "study"):
        return _ABSENT
    hours = seconds * _STUDY_IMAGES / _STUDY_TRAINED / 3600
    return f"{hours:.1f} by one of 10 trainings of 5 epochs, which took {seconds} s"


def _candidates(files: dict[str, str]) -> str:
    seconds = _took(files.get("search", ""))
    if not seconds or not _has_ended(files, "search"):
        return _ABSENT
    return f"{61 * 3600 / seconds:,.0f} with its start and its images, which took {seconds} s"


def _retrained(text: str) -> str:
    count, same = re.search(r"^retrained: (\d+ of \d+)", text, re.MULTILINE), "are bit for bit as recorded" in text
    differing = next((line for line in text.splitlines() if " differs in " in line), _ABSENT)
    return f"{count[1]}, bit for bit" if count and same else differing


def _killed(text: str) -> str:
    return next((line for line in text.splitlines() if line.startswith("equal bytes")), _ABSENT)


def _level(text: str) -> str:
    levels = re.findall(r'"level": "(\w+)"', text)
    return ", ".join(dict.fromkeys(levels)) or _ABSENT


def main(arguments: Sequence[str]) -> int:
    """Print the rows of a directory of results."""
    if len(arguments) != 1 or not Path(arguments[0]).is_dir():
        print("expected the directory that benchmarks/on_a_gpu.sh wrote", file=sys.stderr)
        return 2
    files = {path.stem: path.read_text(encoding="utf-8") for path in sorted(Path(arguments[0]).glob("*.txt"))}
    print(files.get("versions", "").strip(), "\n")
    print(table(["figure", "goal", "measured"], goals(files)))
    for name in ("start", "bench", "precision"):
        for rows in tables(files.get(name, "")):
            if rows:
                print(f"\n{name}:\n{table([*rows[0]], [[*row.values()] for row in rows])}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
