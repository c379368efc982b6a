"""What a user may set for a study; as in `tacevo.config.schema`, checked as soon as it is built."""

from dataclasses import dataclass

from tacevo.choices import MarginKind
from tacevo.config.checks import is_positive, require
from tacevo.config.schema import ExecutorConfig


@dataclass(kw_only=True)
class StudyStoreConfig:
    """Where trainings are recorded."""

    #: None for where the run has its stores.
    root: str | None = None

    def __post_init__(self) -> None:
        """Refuse an empty name."""
        require(self.root != "", "store.root", "the name of a folder, or null", self.root)


@dataclass(kw_only=True)
class MarginConfig:
    """The largest difference from the baseline that counts as none."""

    #: In parts of the baseline's median, or in the unit of the metric.
    value: float
    kind: MarginKind


@dataclass(kw_only=True)
class MarginsConfig:
    """A margin for each kind of task."""

    #: Of the test MSE.
    regression: MarginConfig
    #: Of the test accuracy, in [0, 1].
    classification: MarginConfig

    def __post_init__(self) -> None:
        """Check the ranges."""
        for kind, margin in (("regression", self.regression), ("classification", self.classification)):
            require(is_positive(margin.value), f"margins.{kind}.value", "a finite value > 0", margin.value)


@dataclass(kw_only=True)
class StudyConfig:
    """The full training of a run's best networks and its baseline, each with several seeds."""

    executor: ExecutorConfig
    #: The folder of a finished run.
    run: str | None
    #: k, how many elites of the network archive, best validation fitness first; the baseline comes on top.
    elites: int
    #: S, the training seeds of each network.
    seeds: int
    epochs: int
    #: What one training may use.
    seconds: float
    memory_mib: int
    #: Level of the tests, which Holm's correction keeps over all variants.
    alpha: float
    margins: MarginsConfig
    store: StudyStoreConfig

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(bool(self.run), "run", "the folder of a finished run, as in run=runs/NAME", self.run)
        require(self.elites >= 1, "elites", "a value >= 1", self.elites)
        require(self.seeds >= 1, "seeds", "a value >= 1", self.seeds)
        require(self.epochs >= 1, "epochs", "a value >= 1", self.epochs)
        require(is_positive(self.seconds), "seconds", "a finite value > 0", self.seconds)
        require(self.memory_mib >= 64, "memory_mib", "a value >= 64", self.memory_mib)
        require(0 < self.alpha < 1, "alpha", "a value in (0, 1)", self.alpha)
