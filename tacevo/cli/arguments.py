"""The arguments of the commands that read what was recorded, as `tacevo COMMAND --help` lists them.

What does the work takes seconds to import, so it is imported when the arguments are right and what they name is there.
"""

import argparse
import contextlib
import importlib
import shlex
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from tacevo.cli.common import (
    OVERRIDE,
    Parser,
    add_config_dir,
    check_names,
    place_of_results,
    places_of,
    tell,
    whole_number,
)
from tacevo.storage.places import check_place

#: A run, in the help of the commands that read one.
RUN = "the directory or bundle of a run, or SWEEP.zip/JOB"

#: A run or a sweep, in the help of the commands that read either.
RUNS = "the directory or bundle of a run or a sweep, or SWEEP.zip/JOB"


def _later(
    module: str, command: str, check: Callable[[argparse.Namespace], object] | None = None
) -> Callable[[argparse.Namespace], int]:
    """Return a command of a module, `run_COMMAND`, which is imported when it is called and the options are checked."""

    def run(options: argparse.Namespace) -> int:
        if check is not None:
            check(options)
        for name in [*vars(options).get("runs", ()), *filter(None, [vars(options).get("run")])]:
            tell(f"reading {name}", error=True)  # before the imports, which take seconds
        status: int = getattr(importlib.import_module(f"tacevo.cli.{module}"), f"run_{command}")(options)
        return status

    return run


def named(text: str) -> str:
    """Read the path of a run or a sweep.

    Raises:
        RunError: nothing is there.
    """
    check_place(Path(text))
    return text


def _run_or_setting(word: str) -> str:
    """Read what may be the path of a run, alone or as a setting; a path in quotes, or with others, is read later."""
    key, _, value = word.partition("=")
    if value and key in {"run", "sweep"} and not set(value) & set("'\"\\${}[],"):
        check_place(Path(value))
    elif "=" not in word:
        check_place(Path(word))
    return word


#: What may be set, and what it means; conf/study.yaml has the defaults.
SETTINGS = {
    "run": "the same as RUN alone: the directory of a finished run, whose networks are studied; or",
    "sweep": "that of a sweep: a study of each finished job, with its best elite; or",
    "networks": "files of networks, directories and patterns of such; none for the baseline of task= alone",
    "arms": "those of sweep= whose jobs are studied, as in arms=none,drift (all)",
    "elites": "how many elites of run=, best first, beside the baseline (4)",
    "choose": "best by: fitness (recorded), or reestimated (by `tacevo noise`); the first unless set",
    "seeds": "training seeds of each network (20)",
    "epochs": "of each training; the weights of the best validation epoch are tested (50)",
    "seconds": "the longest time of one training (86400)",
    "memory_mib": "the most memory of one training (4096)",
    "alpha": "level of the tests, after Holm (0.05)",
    "margins.regression.value": "the largest difference of the test MSE that counts as none (0.1)",
    "margins.regression.kind": "relative (to the baseline's median), or absolute; the first unless set",
    "margins.classification.value": "the same for the test accuracy (0.01)",
    "margins.classification.kind": "absolute (in the metric itself), or relative; the first unless set",
    "plan": "the plan.json that it follows, which is kept in it (none)",
    "executor": "local or ray: on this machine, or on the nodes of a Ray cluster; the first unless set",
    "executor.workers": "trainings at once (2)",
    "executor.per_gpu": "with a GPU: most trainings on it at once (as many as fit)",
    "executor.address": "of that cluster, as HOST:PORT or auto; none starts a Ray here",
    "store.root": "the directory of the stores (that of the run)",
}

#: The same of a noise run; conf/noise.yaml has the defaults.
NOISE_SETTINGS = {
    "run": "the same as RUN alone: the directory of a finished run; or",
    "sweep": "that of a sweep: a noise run of each finished job",
    "elites": "how many elites, best validation loss first, beside the baseline (all)",
    "seeds": "training seeds of each network (5)",
    **{key: SETTINGS[key] for key in ("executor", "executor.workers", "executor.per_gpu", "executor.address")},
    "store.root": SETTINGS["store.root"],
}

_EPILOG = """\
examples:
  tacevo study runs/NAME
  tacevo study runs/NAME elites=2 seeds=5 epochs=10 executor.workers=8
  tacevo study runs/NAME margins.regression.value=0.05
  tacevo study runs/NAME data.split_seed=7            # the same networks on other data: any setting of data
  tacevo study sweep=sweeps/NAME seeds=5              # for `tacevo ablations`, which compares arms by these test scores
  tacevo study sweep=sweeps/NAME arms=none,drift      # of two of its arms
  tacevo study networks=library/force/published task=force data.image_size=64
  tacevo study networks=[a.py,b.py] task=grating data=tacverse data.root=DIR data.sensor=A,B   # each, and a table
  tacevo study task=hardness                          # the baseline alone

Beside networks= and task=, settings of `tacevo search` hold for the run that the networks are recorded in: task, data,
training, numerics, gate, sandbox, seed, experiment, tracking and run.dir.

"""

_NOISE_EPILOG = """\
examples:
  tacevo noise runs/NAME
  tacevo noise runs/NAME elites=10 seeds=20 executor.workers=8
  tacevo noise sweep=sweeps/NAME

"""

_CONTINUED = """\
The same command continues what was stopped. Several processes, on one or more machines that share the run and the
store, divide the work."""


def add_study(parser: Parser) -> None:
    """Describe `tacevo study`."""
    parser.description = (
        "Train the baseline and the best elites of a finished run, or of each job of a sweep, or networks of your\n"
        "own, fully, each with the same training seeds, and measure them on the test images. The exit status is 1 if\n"
        "a training or a job did not finish."
    )
    _finish(parser, SETTINGS, _EPILOG)
    add_config_dir(parser)
    parser.set_defaults(command=_later("study", "study"))


def add_noise(parser: Parser) -> None:
    """Describe `tacevo noise`."""
    parser.description = (
        "Train the baseline and the elites of a finished run, or of each job of a sweep, again as its search did, but\n"
        "with other training seeds, so that tables and report can say what its recorded fitnesses are worth. No test\n"
        "image is used. The exit status is 1 if a training or a job did not finish."
    )
    _finish(parser, NOISE_SETTINGS, _NOISE_EPILOG)
    parser.set_defaults(command=_later("study", "noise"))


def _finish(parser: Parser, described: Mapping[str, str], examples: str) -> None:
    """Describe what both commands have in common."""
    width = max(map(len, described))
    settings = "\n".join(f"  {name.ljust(width)}  {meaning}" for name, meaning in described.items())
    parser.epilog = f"settings, with their defaults:\n{settings}\n\n{examples}{_CONTINUED}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.fromfile_prefix_chars = "@"
    settings = "RUN, the directory of a run; KEY=VALUE, or @FILE with one of them a line"
    parser.add_argument("overrides", nargs="*", metavar="RUN or SETTING", type=_run_or_setting, help=settings)


_PLAN_EPILOG = """\
examples:
  tacevo plan study cache/published/grating-grammar.zip --effect 0.01
  tacevo plan sweep sweeps/PILOT --effect 0.05 --comparisons 3 -o plans
  tacevo study runs/NAME seeds=SEEDS plan=build/plan/plan.json
  tacevo search -m ... 'seed=range(0,SEEDS)' --plan plans/plan.json

The plan is kept in the study or the sweep that it is given to. docs/statistics.md says how it is simulated."""


def add_plan(parser: Parser) -> None:
    """Describe `tacevo plan`."""
    parser.description = (
        "Compute how many seeds are needed to detect an effect of a given size after Holm's correction, and the cost.\n"
        "The spread is that of finished pilot runs. The exit status is 1 if no number of seeds that is tried suffices."
    )
    parser.epilog = _PLAN_EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    kinds = parser.add_subparsers(title="what to plan", required=True, metavar="KIND")
    _add_kind(kinds.add_parser("study", help="training seeds of each network"), "RUN", "study", "variants")
    _add_kind(kinds.add_parser("sweep", help="jobs of each arm"), "SWEEP", "sweep", "arms beside the reference")


def add_tabulate(parser: Parser) -> None:
    """Describe `tacevo tabulate`."""
    parser.description = (
        "Probe every network of a closed space (llm.space) and train it fully, for training.epochs epochs with "
        "each of some seeds; write all of it into one file, for searches with data=table. The same command "
        "continues a stopped one."
    )
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=OVERRIDE)
    parser.add_argument("--seeds", type=whole_number, default=1, metavar="N", help="trainings of each network (1)")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="the file to write, such as table.zip")
    add_config_dir(parser)
    parser.set_defaults(command=_later("tabulate", "tabulate"))


def _add_kind(parser: argparse.ArgumentParser, source: str, kind: str, compared: str) -> None:
    of_study = "a pilot run (directory or bundle; all its finished studies are used), or the directory of one study"
    of_sweep = "a pilot sweep (directory or bundle)"
    parser.add_argument("runs", metavar=source, nargs="+", type=named, help=of_study if kind == "study" else of_sweep)
    parser.add_argument(
        "--effect",
        type=_part,
        required=True,
        help="what is to be found: a part of an error (0.1 is 10 %% less), or the difference of an accuracy",
    )
    parser.add_argument(
        "--comparisons", type=whole_number, metavar="N", help=f"{compared} (default: as many as the pilot)"
    )
    parser.add_argument("--power", type=_part, default=0.8, help="wished chance of finding it (0.8)")
    parser.add_argument("--alpha", type=_part, default=0.05, help="level of the tests, after Holm (0.05)")
    parser.add_argument(
        "-o", "--output", metavar="DIR", default="build/plan", help="directory to write to (default: build/plan)"
    )
    parser.set_defaults(command=_later("plan", "plan"), kind=kind)


def _part(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < (value := float(text)) < 1:
            return value
    raise argparse.ArgumentTypeError(f"expected a number between 0 and 1, such as 0.1 for 10 %; got {text}")


def add_trust(parser: Parser) -> None:
    """Add the option that lets a run's own parts decide."""
    parser.add_argument(
        "--trust-parts",
        action="store_true",
        help="let parts that the run's user brought decide again, by their recorded sources in confined processes",
    )


def add_replay(parser: Parser) -> None:
    """Describe `tacevo replay`."""
    parser.description = (
        "Run a recorded search and its finished studies again, without model, training or data set, and compare every "
        "line; of a sweep, every search. With --retrain, also train the candidates again. A published run or sweep is "
        "replayed from its own records, with every table."
    )
    parser.add_argument(
        "run",
        metavar="RUN",
        type=named,
        help="the directory of a run or a sweep, or a file that `tacevo publish` wrote; SWEEP.zip/JOB is one run of it",
    )
    parser.add_argument(
        "--store",
        metavar="DIR",
        help="the directory of its stores, if they were moved; for a published run, where --retrain keeps images",
    )
    parser.add_argument(
        "--retrain",
        nargs="?",
        type=whole_number,
        const=0,
        metavar="N",
        help="then train the candidates again and compare every bit; with N the best network, the networks of studies, "
        "and N others that are drawn at random",
    )
    add_trust(parser)
    parser.add_argument(
        "--draw", type=whole_number, metavar="SEED", help="draw the N as an earlier replay did, which told its seed"
    )
    parser.add_argument(
        "--table",
        metavar="FILE",
        help="with --retrain of searches that looked evaluations up: the table (default: that of their digest, where "
        "it was, beside RUN, or in cache/tables)",
    )
    # For one release, to name what took its place.
    parser.add_argument("--diff", nargs="?", const="OTHER", help=argparse.SUPPRESS)
    parser.set_defaults(command=_later("reproduce", "replay", _check_replay))


def _check_replay(options: argparse.Namespace) -> None:
    if options.draw is not None and not options.retrain:
        options.parser.error("--draw repeats the draw of --retrain N; give both")
    if options.table is not None and options.retrain is None:
        options.parser.error("--table names the table that --retrain looks searches up in; give both")
    if options.diff is not None:
        runs = [Path(name) for name in (options.run, options.diff)]
        is_packed = any(place.is_file() for run in runs for place in (run, *run.parents))
        command = shlex.join(["cmp", *(str(run / "ledger.jsonl") for run in runs)])
        first = "unzip bundles first; then " if is_packed else ""
        options.parser.error(f"--diff is gone: {first}`{command}` names the first line in which two runs differ")


def add_extend(parser: Parser) -> None:
    """Describe `tacevo extend`."""
    parser.description = (
        "Replay a finished run, and search on from its end in a new run directory, whose ledger begins with the lines "
        "of the published one. The published run and its stores are only read."
    )
    parser.add_argument("run", metavar="RUN", type=named, help=RUN)
    parser.add_argument(
        "overrides", nargs="*", metavar="OVERRIDE", help=f"{OVERRIDE}; a larger search.generations is needed"
    )
    parser.add_argument("--store", metavar="DIR", help="the directory of its stores, if they were moved")
    add_trust(parser)
    add_config_dir(parser)
    parser.set_defaults(command=_later("reproduce", "extend"))


def add_export(parser: Parser) -> None:
    """Describe `tacevo export`."""
    parser.description = (
        "Train a candidate again in the sandbox, and write it as a directory that needs no tacevo: the class, its "
        "weights, ONNX where it can hold the network, a model card. Needs `pip install -e '.[export]'`."
    )
    parser.add_argument("run", metavar="RUN", type=named, help=RUN)
    parser.add_argument("candidate", metavar="CANDIDATE", help="its id, e.g. g02s03")
    parser.add_argument(
        "overrides",
        metavar="KEY=VALUE",
        nargs="*",
        help="seeds=K, an ensemble of K trainings; epochs=N; like=study, the default, or like=search; licence=ID; "
        "data.root=DIR, if the data set was moved",
    )
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="the directory, which must not exist")
    parser.add_argument("--store", metavar="DIR", help="the directory of its stores, if they were moved")
    parser.add_argument(
        "--retrained",
        action="store_true",
        help="fail where a training is not recorded, or goes otherwise than recorded",
    )
    # For one release, to name what took its place.
    parser.add_argument("--register", nargs="?", const="NAME", help=argparse.SUPPRESS)
    parser.set_defaults(
        command=_later("export", "export", _check_export), interrupted="the directory is whole or absent"
    )


def _check_export(options: argparse.Namespace) -> None:
    if options.register is not None:
        model, name = f"{options.output}/model.onnx", options.register
        instead = f"mlflow.onnx.log_model(onnx.load({model!r}), name='model', registered_model_name={name!r})"
        options.parser.error(f"--register is gone: export without it, then call {instead}")


def add_publish(parser: Parser) -> None:
    """Describe `tacevo publish`."""
    parser.description = (
        "Replay a finished run or sweep and its studies, and write all that a replay elsewhere needs, with tables, "
        "figures, licence and checksums, into one file: an RO-Crate."
    )
    parser.add_argument("run", metavar="RUN", type=named, help="the directory of a run or of a sweep")
    parser.add_argument(
        "studies", metavar="STUDY", nargs="*", help="the directory of a study of a run (default: all finished ones)"
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="e.g. run.zip")
    parser.add_argument("--store", metavar="DIR", help="the directory of the run's stores, if they were moved")
    parser.add_argument(
        "--license", default="CC-BY-4.0", metavar="SPDX", help="of what is published (default: CC-BY-4.0)"
    )
    parser.add_argument("--author", action="append", default=[], metavar="NAME", help="may be given several times")
    parser.add_argument("--date", default="", metavar="YYYY-MM-DD", help="of publication (default: the end of the run)")
    parser.set_defaults(
        command=_later("publish", "publish"), interrupted="nothing was written; the same command begins again"
    )


def add_show(parser: Parser) -> None:
    """Describe `tacevo show`."""
    parser.add_argument("run", metavar="RUN", type=named, help=RUNS)
    parser.add_argument("candidate", metavar="CANDIDATE", nargs="?", help="its id, e.g. g02s03")
    parser.add_argument("--source", action="store_true", help="only its source, with the imports that it was given")
    parser.set_defaults(command=_later("show", "show"))


#: Of the files of figures.
FORMATS = ("pdf", "svg", "png")


def add_figures(parser: Parser) -> None:
    """Describe `tacevo figures`."""
    parser.description = "Draw every figure of finished runs and their studies, and of sweeps."
    parser.add_argument("runs", metavar="RUN", nargs="+", type=named, help=RUNS)
    parser.add_argument(
        "--format", nargs="+", choices=FORMATS, default=FORMATS, help="of the files (default: all three)"
    )
    _add_places(parser, "figures")
    parser.set_defaults(command=_later("figures", "figures", partial(places_of, name="figures")))


def add_ablations(parser: Parser) -> None:
    """Describe `tacevo ablations`."""
    parser.description = (
        "Compare the arms of a sweep by its finished jobs: print a table of them, and write all as .tex, .md and .csv, "
        "with figures as .pdf."
    )
    parser.add_argument("runs", metavar="SWEEP", nargs=1, type=named, help="the directory or bundle of a sweep")
    parser.add_argument("-o", "--output", metavar="DIR", help="where to write (default: SWEEP/ablations)")
    parser.add_argument(
        "--reference", metavar="ARM", help="the arm to compare with (default: the one that the sweep states, or none)"
    )
    _add_store(parser)
    parser.set_defaults(command=_later("figures", "ablations", partial(places_of, name="ablations")))


def add_report(parser: Parser) -> None:
    """Describe `tacevo report`."""
    parser.description = (
        "Write one HTML file with which a finished run and its studies, or a finished sweep, can be looked into; or "
        "with --latex every table and figure of several, in a LaTeX document, and its PDF where LaTeX is installed."
    )
    parser.add_argument("runs", metavar="RUN", nargs="+", type=named, help=RUNS)
    parser.add_argument(
        "-o",
        "--output",
        metavar="PLACE",
        help="file to write (default for a directory: RUN/report.html), or with --latex directory (build/paper)",
    )
    parser.add_argument(
        "--follow",
        action="store_true",
        help="write the page again while searches are at work, until they are finished; it reloads itself",
    )
    parser.add_argument(
        "--latex", action="store_true", help="write a LaTeX document of all, with their tables and figures"
    )
    _add_store(parser)
    parser.set_defaults(command=_later("report", "report", _check_report))


def _check_report(options: argparse.Namespace) -> None:
    if options.latex:
        check_names(options.runs)
        if options.follow:
            options.parser.error("--follow writes a page again, so it does not go with --latex")
    elif len(options.runs) > 1:
        options.parser.error(f"{len(options.runs)} runs have no page together; with --latex they have a document")
    else:
        place_of_results(options, "report.html")


def add_tables(parser: Parser) -> None:
    """Describe `tacevo tables`."""
    parser.description = (
        "Write every table of finished runs and sweeps as .tex, .md and .csv, and print those that a paper needs; "
        "index.md says which question each answers."
    )
    parser.add_argument("runs", metavar="RUN", nargs="*", type=named, help=f"{RUNS}; optional with --paper")
    parser.add_argument("--paper", action="store_true", help="the paper's own tables, too, and one beside the runs")
    parser.add_argument("--latex", action="store_true", help="print LaTeX instead of Markdown")
    parser.add_argument(
        "--columns",
        nargs="+",
        metavar="NAME",
        default=(),
        help="show only these beside the first one, where a table has any of them; .csv has all",
    )
    parser.add_argument(
        "--notes",
        choices=("none", "short", "full"),
        default="full",
        help="below a table: none, the first sentence of each, or all (default: full)",
    )
    _add_places(parser, "tables")
    parser.set_defaults(command=_later("tables", "tables", _check_tables))


def _check_tables(options: argparse.Namespace) -> None:
    if options.runs:
        places_of(options, "tables")
    elif not options.paper:
        options.parser.error("name a run or a sweep, or give --paper for the paper's tables")


def _add_places(parser: Parser, what: str) -> None:
    """Describe where these commands read and write."""
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        help=f"where to write (default: RUN/{what}; several need it, and go to DIR/NAME)",
    )
    _add_store(parser)


def _add_store(parser: Parser) -> None:
    """Describe what all these commands have in common."""
    parser.add_argument("--store", metavar="DIR", help="directory of the stores, if it was moved")
    parser.set_defaults(interrupted="every written file is complete; run the same command again for the rest")
