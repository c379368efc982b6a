"""The rooms that can be left out, and a process in which they are hidden from import."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

#: By name: modules, and libraries that nothing else needs.
ROOMS: Mapping[str, str] = {
    "ray": "tacevo.cluster ray",
    "mlflow": "tacevo.tracking tacevo.cli.track mlflow",
    "export": "tacevo.export tacevo.cli.export onnx onnxruntime onnxscript safetensors",
    "hosted": (
        "tacevo.llm.claude tacevo.llm.anthropic tacevo.llm.openai tacevo.llm.batches tacevo.llm.hosted "
        "tacevo.llm.streams tacevo.llm.wire tacevo.llm.bodies tacevo.llm.retry anthropic openai httpx2"
    ),
    "batches": "tacevo.llm.batches",
    "grammar": "tacevo.llm.grammar",
    "simulator": "tacevo.data.simulator",
    "tacverse": "tacevo.data.sources.tacverse tacevo.data.sources.release",
    "table": (
        "tacevo.results.space_table tacevo.results.table_checks tacevo.results.table_records "
        "tacevo.results.gene_model tacevo.results.judged_loss tacevo.studies.tabulate tacevo.studies.judge "
        "tacevo.cli.tabulate tacevo.cli.judge tacevo.runs.table_answers "
        "tacevo.reproduce.space_table tacevo.api.space_tables tacevo.api.space_problems analysis.statistics.spaces"
    ),
    "slurm": "tacevo.sweeps.slurm submitit",
    "page": "analysis.report.page analysis.report.following tacevo.api.page",
    "document": "analysis.report.document tacevo.cli.document",
    "motifs": "analysis.motifs analysis.tables.motifs",
    "figures": "analysis.figures analysis.report.figure_list tacevo.cli.figures matplotlib",
    "estimate": "tacevo.runs.estimate tacevo.runs.pace",
    "data check": "tacevo.runs.data_check tacevo.runs.data_report tacevo.data.pictures tacevo.data.survey",
    "init": "tacevo.cli.init tacevo.cli.new_part tacevo.cli.templates tacevo.config.new_task tacevo.config.supplement",
    "crate": "tacevo.bundles.crate rocrate",
    "image tests": "analysis.tables.images analysis.studies.image_findings",
    "transfer": "analysis.tables.transfer analysis.studies.transfer",
    "published": "analysis.tables.published",
    "gpus": "tacevo.training.leases",
    "surrogate": "tacevo.evolution.surrogate",
    "Pareto": (
        "analysis.runs.pareto analysis.statistics.pareto analysis.tables.pareto analysis.figures.pareto "
        "analysis.report.pareto"
    ),
    "alarms": "analysis.runs.health analysis.tables.health",
    "effects of instructions": "analysis.runs.instruction_effects analysis.tables.instruction_tables",
    "plans, pilots": (
        "analysis.sweeps.plans analysis.sweeps.pilots analysis.statistics.planning analysis.tables.plan "
        "tacevo.api.planning tacevo.cli.plan"
    ),
    "pairs": "analysis.sweeps.pairs analysis.tables.pairs tacevo.cli.pairs",
    "noise": (
        "tacevo.studies.noise tacevo.cli.noise tacevo.results.noise_runs analysis.tables.noise "
        "analysis.tables.noise_outcome analysis.studies.noise analysis.studies.corrected analysis.statistics.seed_noise"
    ),
}

#: Python imports it first in every process: what is hidden is found nowhere, as if it were not installed.
HIDES = """
import sys
from importlib.machinery import PathFinder

class Hiding(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if any(name == each or name.startswith(each + ".") for each in NAMES):
            return None
        return PathFinder.find_spec(name, path, target)

sys.meta_path = [Hiding if finder is PathFinder else finder for finder in sys.meta_path]
"""

#: One command after the other, in one process; prints the exit status of each.
_RUN = """
import contextlib, io, json, shlex, sys
from tacevo.cli.app import main
for line in sys.stdin.read().splitlines():
    printed = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed[0]), contextlib.redirect_stderr(printed[1]):
        try:
            status = main(shlex.split(line))
        except SystemExit as ended:
            status = ended.code
    print(json.dumps([status, *(each.getvalue() for each in printed)]))
"""

#: The exit status of a command, what it printed, and what it said on standard error.
Ended = tuple[int, str, str]


def _without_labs(path: Sequence[str]) -> list[str]:
    """Return the import path without packages that stand for a lab's: a test of this process may have used them."""
    return [each for each in path if not each.endswith("tests/support/lab")]


def run_without(
    hidden: str, commands: Sequence[str], folder: Path, cwd: Path, installed: Sequence[Path] = ()
) -> list[Ended]:
    """Run commands where some modules cannot be imported; the folder is for the file that hides them.

    `installed` are directories of further packages.
    """
    told = ask_without(hidden, _RUN, "\n".join(commands), folder=folder, cwd=cwd, installed=installed)
    return [tuple(json.loads(line)) for line in told.splitlines()]


def ask_without(
    hidden: str, program: str, given: str, *, folder: Path, cwd: Path, installed: Sequence[Path] = ()
) -> str:
    """Run a program with a text as its standard input, as `run_without` does; return what it prints."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sitecustomize.py").write_text(f"NAMES = {hidden.split()!r}\n{HIDES}", encoding="utf-8")
    keys = {"ANTHROPIC_API_KEY": "none-that-is-asked", "OPENAI_API_KEY": "none-that-is-asked"}
    path = [str(folder), *map(str, installed), *_without_labs(sys.path)]
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=given,
        cwd=cwd,
        env={
            **os.environ,
            **keys,
            "PYTHONPATH": os.pathsep.join(path),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
