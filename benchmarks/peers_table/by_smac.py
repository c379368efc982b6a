"""SMAC3: Bayesian optimisation by a random forest, its default for categorical variables."""

import tempfile
from collections.abc import Generator
from pathlib import Path

from ConfigSpace import Categorical, ConfigurationSpace
from smac import HyperparameterOptimizationFacade, Scenario
from smac.runhistory.dataclasses import TrialValue

from benchmarks.peers_table.asking import Choices, Genes


def forest(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Search by the facade for hyperparameters; a quarter of the trainings are its initial design."""
    space = ConfigurationSpace(seed=seed)
    space.add(*(Categorical(name, [*map(str, range(len(values)))]) for name, values in choices.items()))
    with tempfile.TemporaryDirectory() as folder:
        scenario = Scenario(space, deterministic=True, n_trials=trainings, seed=seed, output_directory=Path(folder))
        smac = HyperparameterOptimizationFacade(scenario, _told, logging_level=False, overwrite=True)
        while True:
            trial = smac.ask()
            fitness = yield {name: values[int(trial.config[name])] for name, values in choices.items()}
            smac.tell(trial, TrialValue(cost=fitness))


def _told(config: object, seed: int = 0) -> float:
    """Stand for the function that a facade wants and that ask and tell never call."""
    raise NotImplementedError
