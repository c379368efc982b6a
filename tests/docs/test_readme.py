"""Promises: README is read in five minutes, and shows what its commands print and what the published tables say."""

import io
import re
import shlex
import zipfile
from fnmatch import fnmatch

import pytest
from checkout import GOLDEN, PUBLISHED, ROOT
from rich.console import Console

import tacevo
from analysis.report.collection import outcomes, read_studies
from analysis.tables.rendering import as_text
from tacevo.bundles.open import opened
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.identity import config_hash
from tacevo.evolution.lines import GenerationLine
from tacevo.reproduce.demo import DEMO, compared
from tacevo.reproduce.replay import replay
from tacevo.results.study_directory import studies_of
from tacevo.rules import CURRENT
from tacevo.runs.progress import Progress
from tacevo.studies.study import replay_studies

README = (ROOT / "README.md").read_text(encoding="utf-8")


def row_of(bundle: str, table: str, start: str) -> str:
    """Read the row of a published table that begins with a name, as README writes it: hyphens for minus signs."""
    with zipfile.ZipFile(PUBLISHED / f"{bundle}.zip") as opened:
        (name,) = (name for name in opened.namelist() if fnmatch(name, f"tables/{table}.md"))
        lines = opened.read(name).decode().replace("\N{MINUS SIGN}", "-").splitlines()
    (row,) = (line for line in lines if re.match(rf"\| {re.escape(start)} +\|", line))
    return row


@pytest.mark.parametrize(
    ("first", "bundle", "table"),
    [
        ("arm, 8 searches each", "ablation-proposals", "ablation_new_quartile*"),
        ("network", "grating-claude", "verdicts_*epochs6-*"),
    ],
)
def test_readme_shows_rows_of_published_tables(first: str, bundle: str, table: str) -> None:
    """Each value of each row of the table that begins with a column stands in that row of the published one."""
    (shown,) = re.findall(rf"^\| {first} \|.*\n\|[-|]+\|\n((?:\|.*\|\n)+)", README, flags=re.MULTILINE)
    for row in shown.splitlines():
        name, *values = (cell.strip().removesuffix(" %") for cell in row.strip("|").split("|"))
        published = row_of(bundle, table, name).replace("\\", "").replace(" %", "")
        assert [value for value in values if value.replace(" %", "") not in published] == []


def section_of(title: str) -> str:
    """Return the text of a section of README."""
    return README.split(f"## {title}\n")[1].split("\n## ")[0]


def blocks_of(title: str) -> list[str]:
    """Return the blocks of code in a section of README."""
    return re.findall(r"^```\w+\n(.*?)^```$", section_of(title), flags=re.MULTILINE | re.DOTALL)


def test_readme_shows_what_a_replay_says(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The command of its section is run, and what stands below it are lines of its output; they are wrapped."""
    monkeypatch.chdir(ROOT)
    commands, shown = blocks_of("Check somebody else's result")
    assert main(shlex.split(commands.splitlines()[-1])[1:]) == 0
    said = " ".join(capsys.readouterr().out.split())
    first, verdict, digest = re.split(r"\n(?=EQUAL|digest)", shown)
    assert [part for part in (first, verdict, digest) if " ".join(part.split()) not in said] == []


@pytest.mark.room("noise")
def test_readme_shows_what_the_demo_prints() -> None:
    """The lines below `make demo` are those of its recorded run, which is what the demo is today.

    Where it is another one: make demo, then tacevo publish runs/demo -o tests/golden/demo.zip.
    """
    bundle = opened(GOLDEN / "demo.zip")
    run = bundle.read(bundle.folder)
    assert (config_hash(run.config), run.rules) == (config_hash(compose(["experiment=demo"])), CURRENT)
    out = io.StringIO()
    replay(run, Progress(Console(file=out)))
    *_, last = (line for line in run.ledger.lines if isinstance(line, GenerationLine))
    trained = f": {last.trained} of {last.candidates} candidates trained,"
    (noise,) = replay_studies(run, Progress(Console(file=out))).values()
    (outcome,) = outcomes(run, read_studies(run)).values()
    assert f"elites={len(noise.record.networks) - 1} seeds={noise.record.seeds}" in (ROOT / "Makefile").read_text()
    assert noise.record.digest == DEMO.digest
    assert {name: run.record.versions[name] for name in DEMO.versions} == DEMO.versions
    (folder,) = studies_of(run.path)
    lines = [
        out.getvalue().splitlines()[-1].replace(" replayed:", trained),
        as_text(outcome).splitlines()[0],
        f"run digest: {run.digest} (the one to cite; the digest below is that of the noise run)",
        f"digest: {noise.record.digest}",
        compared(run, folder),
    ]
    _, shown = blocks_of("Run your own")
    assert shown.split() == " ".join(lines).split()


def test_python_of_readme_runs() -> None:
    """Each line but the search."""
    (block,) = blocks_of("From Python")
    *lines, search = block.splitlines()
    assert "tacevo.search(" in search
    exec("\n".join(lines).replace('"cache/', f'"{ROOT}/cache/'), {"tacevo": tacevo})
