"""Optuna: a study whose trials suggest each gene as a categorical variable."""

from collections.abc import Generator

import optuna

from benchmarks.peers_table.asking import Choices, Genes

optuna.logging.set_verbosity(optuna.logging.WARNING)


def tpe(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Search by its default, the tree-structured Parzen estimator, which begins with ten random trials."""
    yield from _study(optuna.samplers.TPESampler(seed=seed), choices)


def random(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Draw at random."""
    yield from _study(optuna.samplers.RandomSampler(seed=seed), choices)


def _study(sampler: optuna.samplers.BaseSampler, choices: Choices) -> Generator[Genes, float, None]:
    study = optuna.create_study(sampler=sampler)
    while True:
        trial = study.ask()
        fitness = yield {name: trial.suggest_categorical(name, list(values)) for name, values in choices.items()}
        study.tell(trial, fitness)
