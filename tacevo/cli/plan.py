"""The command `tacevo plan`: how many seeds a study or a sweep needs, before anything of it is trained."""

import argparse
import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from analysis.runs.run import Run, load_run
from analysis.studies.scores import Study
from analysis.studies.study import load_study
from analysis.sweeps.ablation import ALPHA
from analysis.sweeps.pilots import Pilot, study_pilot, sweep_pilot
from analysis.sweeps.plans import Wish, plan
from analysis.sweeps.sweep import load_sweep
from analysis.tables.plan import plan_table
from tacevo.bundles.open import opened
from tacevo.cli.common import DIFFERENT, DONE, Parser, output_directory
from tacevo.cli.tables import show
from tacevo.errors import RunError
from tacevo.storage.files import write_durably
from tacevo.storage.plan import plan_text
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.directory import studies_of

_EPILOG = """\
examples:
  tacevo plan study cache/published/force-grammar.zip --effect 0.1
  tacevo plan sweep sweeps/PILOT --effect 0.05 --comparisons 3 -o plans
  tacevo study run=runs/NAME seeds=SEEDS plan=build/plan/plan.json
  tacevo search -m ... 'seed=range(0,SEEDS)' --plan plans/plan.json

The plan is kept in the study or the sweep that it is given to, whose tables show what was planned beside what was
done. docs/statistics.md says how it is simulated."""


def add_plan(parser: Parser) -> None:
    """Describe `tacevo plan`."""
    parser.description = (
        "Say how many seeds find a wished effect after Holm's correction, by the spread of finished pilots, and what\n"
        "they cost. The exit status is 1 if no number of seeds that is tried suffices."
    )
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    kinds = parser.add_subparsers(title="what to plan", required=True, metavar="KIND")
    _add_kind(kinds.add_parser("study", help="training seeds of each network"), "RUN", "study", "variants")
    _add_kind(kinds.add_parser("sweep", help="jobs of each arm"), "SWEEP", "sweep", "arms beside the reference")


def _add_kind(parser: argparse.ArgumentParser, source: str, kind: str, compared: str) -> None:
    others = " of its finished studies, or the directory of a study" if kind == "study" else ""
    parser.add_argument(
        "pilots", metavar=source, nargs="+", help=f"the directory or bundle of a pilot {source.lower()}{others}"
    )
    parser.add_argument(
        "--effect",
        type=_part,
        required=True,
        help="what is to be found: a part of an error (0.1 is 10 %% less), or the difference of an accuracy",
    )
    parser.add_argument("--comparisons", type=_count, metavar="N", help=f"{compared} (default: as many as the pilot)")
    parser.add_argument("--power", type=_part, default=0.8, help="wished chance of finding it (0.8)")
    parser.add_argument("--alpha", type=_part, default=ALPHA, help=f"level of the tests, after Holm ({ALPHA:g})")
    parser.add_argument("-o", "--output", metavar="DIR", default="build/plan", help="default: build/plan")
    parser.set_defaults(command=_plan, kind=kind)


def _plan(options: argparse.Namespace) -> int:
    with contextlib.ExitStack() as open_bundles:
        pilot = _pilot(options.kind, [Path(name) for name in options.pilots], open_bundles)
        wish = Wish(
            effect=options.effect,
            alpha=options.alpha,
            power=options.power,
            comparisons=options.comparisons or pilot.comparisons,
        )
        planned = plan(pilot, wish)
    directory = output_directory(options.output)
    show([plan_table(planned)], directory)
    if planned.plan is None:
        (directory / "plan.json").unlink(missing_ok=True)  # of an earlier wish
        print("no plan: wish for a larger effect or a lower power, or compare fewer")
        return DIFFERENT
    made = replace(planned.plan, made=datetime.now(UTC).date().isoformat())
    write_durably(directory / "plan.json", plan_text(made))
    print(f"plan: {directory / 'plan.json'}, {made.dated}")
    return DONE


def _pilot(kind: str, paths: Sequence[Path], open_bundles: contextlib.ExitStack) -> Pilot:
    if kind == "study":
        return study_pilot([pair for path in paths for pair in _studies(path, open_bundles)])
    return sweep_pilot([load_sweep(_sweep(path, open_bundles)) for path in paths])


def _sweep(path: Path, open_bundles: contextlib.ExitStack) -> Path:
    """Return the directory of a sweep, which need not be finished, or of a bundle's."""
    folder = open_bundles.enter_context(opened(path)).folder if path.is_file() else path
    if not SweepDirectory(folder).is_one:
        raise RunError("another one", place=str(path), expected="the directory or bundle of a sweep")
    return folder


def _studies(path: Path, open_bundles: contextlib.ExitStack) -> Iterator[tuple[Run, Study]]:
    """Read the finished studies of a pilot, each with its run."""
    if (path / "study.json").exists():
        yield load_run(path.resolve().parents[1]), load_study(path)
        return
    found = 0
    for folder in open_bundles.enter_context(opened(path)).runs:
        run = load_run(folder)
        for directory in studies_of(folder):
            record = directory.read()
            if record.terms is not None and record.digest is not None:
                found += 1
                yield run, load_study(directory.path)
    if not found:
        remedy = f"`tacevo study run={path}` makes one; a few seeds will do for a pilot"
        raise RunError("none", place=str(path), expected="a finished study", remedy=remedy)


def _part(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < (value := float(text)) < 1:
            return value
    raise argparse.ArgumentTypeError(f"expected a number between 0 and 1, such as 0.1 for 10 %; got {text}")


def _count(text: str) -> int:
    with contextlib.suppress(ValueError):
        if (value := int(text)) >= 1:
            return value
    raise argparse.ArgumentTypeError(f"expected an integer of at least 1; got {text}")
