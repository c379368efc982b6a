"""What a choice by one full training is worth: networks of searches, beside a control that no search found.

    python -m benchmarks.handed_over cache/published/ablation-elites.zip cache/published/first-mutations.zip

Each sweep has a study of several networks a job, with two seeds or more. In each job one seed chooses: the network with
the lowest validation loss is handed over, and the other seeds test it. Its worth is its test loss over that of the
baseline by the same seeds; every seed chooses once, and a job's value is the geometric mean. Jobs of one seed, in
whatever arm and sweep, share their training seeds and their baseline, so the seed is the unit: intervals are Student's,
of the logarithms over seeds, and arms are compared by seed with Wilcoxon's test, with Holm's correction.

Where several sweeps are given, the last one is the control.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

import tacevo
from analysis.statistics.tests import holm
from benchmarks.written import geometric_mean
from tacevo.api.studies import Study
from tacevo.storage.sweep_directory import Job, SweepDirectory


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row an arm, and what each differs by from the control."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweeps", nargs="+", metavar="SWEEP", help="a sweep or its bundle; the last is the control")
    found: list[dict[str, dict[int, float]]] = []
    for place in parser.parse_args(arguments).sweeps:
        sweep = tacevo.open(place)
        if not isinstance(sweep, tacevo.Sweep):
            parser.error(f"{place}: expected a sweep with studies; got a run")
        found.append({f"{place}: {arm}": values for arm, values in _arms(sweep).items()})
        for name, values in found[-1].items():
            print(
                f"{name}: {geometric_mean(list(values.values()), 3)} of the baseline's test loss, {len(values)} seeds"
            )
    *searches, controls = found
    pairs = {
        (name, control): [own[seed] - values[seed] for seed in sorted(own.keys() & values.keys())]
        for control, own in controls.items()
        for name, values in ((name, values) for sweep in searches for name, values in sweep.items())
    }
    corrected = holm([float(wilcoxon(each).pvalue) for each in pairs.values()]) if pairs else []
    for ((name, control), each), p in zip(pairs.items(), corrected, strict=True):
        print(
            f"{control} against {name}: {geometric_mean(each, 3)} of its ratio, {len(each)} seeds, p after Holm {p:.2g}"
        )


def against_baseline(scores: pd.DataFrame) -> pd.DataFrame:
    """Return the logarithm of each network's test loss over that of the baseline: a row a seed, a column a network.

    The scores are those of a study, a row a training. A failed training has no loss.
    """
    (loss,) = {"cross_entropy", "mse"} & {*scores.columns}
    losses = np.log(scores.pivot_table(index="seed", columns="network", values=loss))
    return losses.sub(losses.baseline, axis=0).drop(columns="baseline")


def more_right(scores: pd.DataFrame) -> pd.DataFrame:
    """Return by how many points each network's test accuracy is above the baseline's, as `against_baseline`."""
    points = 100 * scores.pivot_table(index="seed", columns="network", values="accuracy")
    return points.sub(points.baseline, axis=0).drop(columns="baseline")


def chosen(scores: pd.DataFrame, worth: Callable[[pd.DataFrame], pd.DataFrame] = against_baseline) -> Iterator[float]:
    """Yield, for each seed that chooses, the mean worth of the chosen network by the other seeds.

    By the seed of a failed training its network is not chosen.
    """
    validation = scores.pivot_table(index="seed", columns="network", values="validation_loss").drop(columns="baseline")
    test = worth(scores)
    for seed in validation.index:
        yield float(test.loc[test.index != seed, validation.loc[seed].idxmin()].mean())


def studied(sweep: tacevo.Sweep) -> Iterator[tuple[Job, tacevo.Run, Study]]:
    """Yield each study that tests networks, with its job and run.

    Jobs are read one by one: those of the control differ in their networks too, so as a sweep they cannot be compared.
    """
    for job in SweepDirectory(sweep.place.folder).read().jobs:
        run = sweep.run(job.name)
        for study in run.studies:
            if not (study.is_noise or study.is_choice):
                yield job, run, study


def _arms(sweep: tacevo.Sweep) -> dict[str, dict[int, float]]:
    """Return the logarithm of the ratio of each job with a study, by arm and seed."""
    arms: dict[str, dict[int, float]] = {}
    for job, _, study in studied(sweep):
        arms.setdefault(job.arm, {})[job.seed] = float(np.mean([*chosen(study.scores)]))
    return arms


if __name__ == "__main__":
    main()
