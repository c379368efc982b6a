"""The command `tacevo noise`, of a run or of the jobs of a sweep."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from tacevo.cli.common import tell
from tacevo.cli.study import composed, end, introduce, report_sweep, show_found
from tacevo.config.compose import compose_noise, compose_study
from tacevo.environment import as_typed
from tacevo.reproduce.demo import compared
from tacevo.results.lineage import changes, layer_changes
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import StudyDirectory, medians_of
from tacevo.runs.progress import Progress
from tacevo.studies.noise import estimate_noise, estimate_noise_of_sweep
from tacevo.text import counted, listed

#: The most layers that are named.
_LAYERS = 8


def run_noise(words: Sequence[str]) -> int:
    """Train elites again under other seeds."""
    config = composed(compose_noise, words)
    if config.sweep is not None:
        with Progress() as view:
            noise_runs, unfinished = estimate_noise_of_sweep(Path(config.sweep), config, view)
        return report_sweep(Path(config.sweep), noise_runs, unfinished, "noise run", "lower elites=")
    with Progress() as view:
        studied = estimate_noise(config, view)
    introduce(studied, "noise run")
    run, noise = show_found(studied, config.store.root), StudyDirectory(studied.directory)
    if run.answered and not run.shortfall and not run.config.data.facts.is_looked_up:
        usual = compose_study(["run=RUN"])
        elites = min(len(noise.read().networks) - 1, usual.elites)
        # One training of each elite chooses one of them; it and the baseline are trained with the seeds that test.
        trainings = f"{counted(elites + 2 * usual.seeds, 'training')} of {counted(usual.epochs, 'epoch')}"
        command = f"{as_typed('tacevo')} study {shlex.quote(str(run.path))} choose=validated elites={elites}"
        tell(f"next:   {command}    # {trainings}")
    if not run.shortfall and (found := _best(run, noise)):
        tell(f"lowest: {found}, for which these instructions were given in turn: {'; '.join(changes(run, found))}")
        tell(f"code:   {_in_code(run, found)}")
    status = end(studied, "noise run", "lower elites=")
    if told := compared(run, noise):
        tell(told)
    return status


def _in_code(run: RecordedRun, name: str) -> str:
    """Say what a network's code has and the baseline's has not: instructions say only what was asked for."""
    lines = {line.id: line for line in run.candidates}
    baseline, found = (run.directory.read_source(one, str(lines[one].source)) for one in (run.baseline.id, name))
    new, gone = layer_changes(baseline, found)
    parts = [f"{words} {listed(layers, most=_LAYERS)}" for words, layers in (("new", new), ("gone", gone)) if layers]
    beside = f"beside the baseline's: {'; '.join(parts)}" if parts else "its layers are the baseline's"
    random = "; the grammar makes random edits, too, so code and instructions can differ"
    edits = "" if run.config.llm.facts.is_model else random
    look = f"{as_typed('tacevo')} show {shlex.quote(str(run.path))} {name}"
    return f"{beside}{edits} (all of it: {look})"


def _best(run: RecordedRun, noise: StudyDirectory) -> str:
    """Return the id of the network whose re-estimate is the lowest; empty where that is the baseline."""
    estimates = medians_of(noise)
    best = min(estimates, key=lambda name: (estimates[name], name), default="")
    return best if changes(run, best) else ""
