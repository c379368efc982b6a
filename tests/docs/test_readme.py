"""Promises: README is read in five minutes, and shows what its commands print and what the published tables say."""

import io
import re
import shlex
import zipfile
from fnmatch import fnmatch

import numpy as np
import pytest
from checkout import GOLDEN, PUBLISHED, ROOT
from rich.console import Console

import tacevo
from analysis.report.collection import outcomes, read_studies
from analysis.tables.rendering import as_text
from tacevo.bundles.open import opened
from tacevo.choices import Numerics
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.identity import config_hash
from tacevo.evolution.lines import GenerationLine
from tacevo.reproduce.demo import DEMO, compared
from tacevo.reproduce.replay import replay
from tacevo.results.run import read_run
from tacevo.results.study_directory import studies_of
from tacevo.rules import CURRENT
from tacevo.runs.progress import Progress
from tacevo.studies.study import replay_studies

README = (ROOT / "README.md").read_text(encoding="utf-8")

#: The finding; the bundle; its table; how the row begins; and figures of that row, as README writes them.
FIGURES = [
    (1, "grating-claude", "noise_*", "variant 1", ("0.0705", "0.544")),
    (1, "grating-claude", "noise_*", "baseline", ("0.911",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "variant 1", ("87.4",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "variant 3", ("96.1",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "baseline", ("57.0",)),
    (2, "ablation-elites", "more/ablation_test_accuracy*", "none", ("95.2",)),
    (2, "ablation-elites", "more/ablation_test_accuracy*", "drift", ("95.1",)),
    (3, "claude-vs-grammar", "ablation_new_quartile*", "none", ("0.253",)),
    (3, "claude-vs-grammar", "ablation_new_quartile*", "llm_vs_grammar", ("0.371", "0.10")),
    (4, "ablation-proposals", "ablation_new_quartile*", "none", ("0.369",)),
    (4, "ablation-proposals", "ablation_new_quartile*", "drift", ("0.500", "0.0031")),
    (4, "ablation-proposals", "ablation_new_quartile*", "best_k", ("0.315", "0.012")),
    (4, "ablation-proposals", "ablation_new_quartile*", "fixed_temperature_0", ("0.31",)),
    (4, "ablation-proposals", "ablation_new_quartile*", "effect_prompts", ("0.31",)),
    (4, "ablation-elites", "more/ablation_test_loss*", "drift", ("0.23",)),
    (5, "grating-variants", "verdicts_*", "baseline", ("89.5",)),
]


def row_of(bundle: str, table: str, start: str) -> str:
    """Read the row of a published table that begins with a name, as README writes it: hyphens for minus signs."""
    with zipfile.ZipFile(PUBLISHED / f"{bundle}.zip") as opened:
        (name,) = (name for name in opened.namelist() if fnmatch(name, f"tables/{table}.md"))
        lines = opened.read(name).decode().replace("\N{MINUS SIGN}", "-").splitlines()
    (row,) = (line for line in lines if re.match(rf"\| {re.escape(start)} +\|", line))
    return row


def stands(figure: str, text: str) -> bool:
    """Return whether a figure stands in a text, whole: not as a part of a longer number."""
    return re.search(rf"(?<![\d.]){re.escape(figure)}(?!\d)", text) is not None


@pytest.mark.parametrize(("finding", "bundle", "table", "start", "figures"), FIGURES)
def test_readme_says_what_the_tables_say(
    finding: int, bundle: str, table: str, start: str, figures: tuple[str, ...]
) -> None:
    """Each figure stands in its row of README and in its row of the table."""
    (told,) = (line for line in README.splitlines() if line.startswith(f"| {finding}. "))
    row = row_of(bundle, table, start)
    for figure in figures:
        assert stands(figure, told)
        assert stands(figure, row)


def test_readme_says_where_the_baseline_ends() -> None:
    """Trained with the seeds of each search's elites: the median of the searches' seeds."""
    ends = next(line for line in README.splitlines() if line.startswith("| 2. "))
    accuracies = {}
    for folder in opened(PUBLISHED / "ablation-elites.zip").runs:
        run = read_run(folder)
        (study,) = read_studies(run).studies
        accuracies[run.config.seed] = study.study.values("baseline", "accuracy").mean()
    assert len(accuracies) == 8
    assert stands(f"{100 * np.median([*accuracies.values()]):.1f}", ends)


@pytest.mark.parametrize(
    ("section", "bundle", "table"),
    [
        ("Compare ablations", "ablation-proposals", "ablation_new_quartile*"),
        ("Tables for a paper", "grating-claude", "verdicts_*epochs6-*"),
    ],
)
def test_readme_shows_rows_of_published_tables(section: str, bundle: str, table: str) -> None:
    """Each value of each of its rows stands in that row of the table."""
    _, _, *rows = re.findall(r"^\|.*\|$", section_of(section), flags=re.MULTILINE)
    assert rows
    for row in rows:
        name, *values = (cell.strip().removesuffix(" %") for cell in row.strip("|").split("|"))
        published = row_of(bundle, table, name).replace("\\", "").replace(" %", "")
        assert [value for value in values if value.replace(" %", "") not in published] == []


@pytest.mark.parametrize(
    ("start", "figure", "ours"),
    [
        ("search", "processor time of a search of 41 candidates", "numerics="),
        ("training", "training at 64 px", "confined, "),
        ("the same", "training at 128 px", "confined, "),
    ],
)
def test_readme_says_the_speed_that_was_measured(start: str, figure: str, ours: str) -> None:
    """Each ratio is that of its row on the page of benchmarks: beside openevolve, or the best bare loop."""
    page = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    head, _, *rows = re.findall(r"^\|.*\|$", section_of("Speed"), flags=re.MULTILINE)
    (told,) = (row for row in rows if row.startswith(f"| {start}"))
    numerics, ratios = ([cell.strip(" `") for cell in line.strip("|").split("|")[1:]] for line in (head, told))
    assert numerics == [*Numerics]
    for choice, ratio in zip(numerics, ratios, strict=True):
        assert re.search(
            rf"^\| {figure} \| {ours}{choice}: .* \| (openevolve|plain torch, fast): .* \| {ratio} \|$",
            page,
            re.MULTILINE,
        )


def section_of(title: str) -> str:
    """Return the text of a section of README."""
    return README.split(f"## {title}\n")[1].split("\n## ")[0]


def blocks_of(title: str) -> list[str]:
    """Return the blocks of code in a section of README, without their indents."""
    blocks = re.findall(r"(?:^    .*\n(?:\n(?=    ))?)+", section_of(title), flags=re.MULTILINE)
    return [re.sub("^    ", "", block, flags=re.MULTILINE) for block in blocks]


def test_readme_shows_what_a_replay_ends_with(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command of its section is run, and the lines below it are the last ones of its output."""
    monkeypatch.chdir(ROOT)
    command, shown = (block for blocks in blocks_of("Replay a published run") for block in blocks.split("\n\n"))
    assert main(shlex.split(command)[1:]) == 0
    lines = shown.splitlines()
    assert capsys.readouterr().out.splitlines()[-len(lines) :] == lines


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
    assert section_of("Start").split("\n\n")[2].split("\n    ") == [
        f"    {out.getvalue().splitlines()[-1].replace(' replayed:', trained)}",
        as_text(outcome).splitlines()[0],
        f"digest: {noise.record.digest}",
    ]
    assert noise.record.digest == DEMO.digest
    assert {name: run.record.versions[name] for name in DEMO.versions} == DEMO.versions
    (folder,) = studies_of(run.path)
    assert compared(run, folder) == "equal to the digest in README: all 69 trainings have the same bits as there"


def test_python_of_readme_runs() -> None:
    """Each line but the search."""
    (block,) = blocks_of("From Python")
    *lines, search = block.splitlines()
    assert "tacevo.search(" in search
    exec("\n".join(lines).replace('"cache/', f'"{ROOT}/cache/'), {"tacevo": tacevo})
