"""The training seeds of a run."""

from tacevo.randomness import derived_seed


def training_seed(seed: int, number: int) -> int:
    """Return the training seed of a number, from 0, of a run's seed; number 0 has the name that it had by itself."""
    return derived_seed(seed, "training", *([number] if number else []))


def judge_seed(seed: int, number: int) -> int:
    """Return the training seed of a number, from 0, of the judge of a table of a run's seed: no search has it."""
    return derived_seed(seed, "judge", number)


def noise_seed(seed: int, number: int) -> int:
    """Return the training seed of a number, from 0, of the noise runs of a run's seed."""
    return derived_seed(seed, "noise", number)


def choice_seed(seed: int) -> int:
    """Return the training seed by which one elite of a run's seed is chosen; no study tests with it."""
    return derived_seed(seed, "choice")


def study_seed(seed: int, number: int) -> int:
    """Return the training seed of a number, from 0, of the studies of a run's seed."""
    return derived_seed(seed, "study", number)
