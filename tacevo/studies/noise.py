"""`tacevo noise`: the baseline and the elites of a run, trained as its search did, with other seeds.

That says how much of each recorded fitness was luck. A noise run of each job of a sweep states nothing and decides
nothing. What was trained is recorded, resumed and replayed as a study is (`tacevo.studies.study`).
"""

from dataclasses import replace
from pathlib import Path

from tacevo.config.study import NoiseConfig
from tacevo.errors import ConfigError
from tacevo.parts.kinds import FITNESS
from tacevo.rules import CURRENT
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.of_sweep import each_job, finished_jobs
from tacevo.studies.study import MirrorLater, Studied, run_to_train, study_job, train_and_record


def estimate_noise(config: NoiseConfig, view: Progress, mirror_later: MirrorLater | None = None) -> Studied:
    """Train the elites of a finished run as its search did, with other seeds, or resume such a noise run; as `study`.

    Raises:
        TacevoError: see its subclasses; the trainings that ended are kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    run = run_to_train(config.run, config.store.root)
    if (fitness := run.config.training.fitness) not in FITNESS.ours:
        expected = f"a run by {', '.join(FITNESS.ours)}: its fitness is that of a part that its user brought"
        raise ConfigError(fitness, place="training.fitness", expected=expected)
    elites = None if isinstance(config.elites, str) else config.elites
    job = study_job(
        run,
        replace(run.config, executor=config.executor),
        elites=elites,
        seeds=config.seeds,
        terms=None,
        chosen_by="",
        planned=None,
        rules=CURRENT.training,
    )
    return train_and_record(job, elites or 0, view, mirror_later=mirror_later)


def estimate_noise_of_sweep(path: Path, config: NoiseConfig, view: Progress) -> tuple[list[Studied], list[str]]:
    """Train the elites of each finished job again, or resume such noise runs; as `study_sweep`."""
    directory = SweepDirectory(path)
    finished = finished_jobs(directory, directory.read().jobs)

    def train(run: str, later: MirrorLater) -> Studied:
        return estimate_noise(replace(config, run=run, sweep=None), view, later)

    studies, unfinished = each_job(directory, finished, train, view)
    return studies, [job.name for job in unfinished]
