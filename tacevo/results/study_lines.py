"""The records of a study: study.json, and the lines of scores.jsonl.

A line's field without a default is in every line; one with a default only where it differs from it.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal

from annotated_types import Ge, Gt, Lt

from tacevo.choices import ChosenBy, Device, Numerics
from tacevo.config.study import Margin
from tacevo.records import DataFacts, Json, Reason, Recipe, Record, Stage
from tacevo.rounding import rounded
from tacevo.rules import FIRST_STUDY
from tacevo.storage.plan_file import SeedPlan
from tacevo.text import assignments
from tacevo.training.full import StoredPredictions
from tacevo.typed import FreeJson

#: Layout of both files.
SCHEMA: Final = 2

#: The name of the first network.
BASELINE: Final = "baseline"


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTerms(Record):
    """The level and the margin by which a study is judged."""

    #: Level of the tests, in (0, 1); each family of p-values keeps it as a whole.
    alpha: Annotated[float, Gt(0), Lt(1)]
    #: The margin of equivalence, in the study's primary metric.
    margin: Margin


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyNetwork(Record):
    """A network that is studied, with what its ledger line says of it."""

    #: `baseline`, `variant 1`, ...
    name: str
    id: str
    #: SHA-256.
    source: str
    fitness: float
    parameters: int
    flops: int

    @property
    def whole_name(self) -> str:
        """The candidate, and what the study calls it: `g12s05 (variant 1)`; the baseline has one name."""
        return self.name if self.name == BASELINE else f"{self.id} ({self.name})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Design(Record):
    """All that the scores of a study follow from, and the terms by which they are judged."""

    LATER: ClassVar[frozenset[str]] = frozenset({"validated"})

    #: Digest of the run.
    run: str
    task: str
    seed: int
    data: DataFacts
    recipe: Recipe
    numerics: Numerics
    device: Device
    #: S, the number of training seeds of each network.
    seeds: Annotated[int, Ge(1)]
    #: None for what takes no test score: a noise run, which trains as the search did, and a choice (`is_choice`).
    terms: StudyTerms | None = None
    #: The baseline first.
    networks: tuple[StudyNetwork, ...]
    #: Digest of the noise run, or of the choice, by whose losses the elites were chosen; empty if by recorded fitness.
    chosen_by: str = ""
    #: (name, value) of the settings that are not the run's, where the study is about other data than the run had.
    other_data: tuple[tuple[str, FreeJson], ...] = ()
    #: The plan that the study follows; None where nothing was planned.
    plan: SeedPlan | None = None
    #: Number of the full trainings; where nothing is tested, of the search's trainings.
    rules: int = FIRST_STUDY
    #: (name, value) of the settings of numerics and device that are not the run's, as `training.device`.
    other_device: tuple[tuple[str, FreeJson], ...] = ()
    #: K, how many elites, at most, were each trained once to choose one of them: of the choice, and of the study of the
    #: chosen one. 0 of all others.
    validated: Annotated[int, Ge(0)] = 0

    @property
    def is_choice(self) -> bool:
        """Whether these are the trainings that chose the elite of another study: long as that study's, and not tested.

        They have one seed, which no study tests with.
        """
        return self.terms is None and self.validated > 0

    @property
    def is_noise(self) -> bool:
        """Whether this is a noise run."""
        return self.terms is None and not self.validated

    @property
    def what(self) -> str:
        """The kind of these trainings, in words."""
        return "choice" if self.is_choice else "noise run" if self.is_noise else "study"

    @property
    def choose(self) -> ChosenBy:
        """The quantity by which the elites were chosen."""
        if self.validated and not self.is_choice:
            return ChosenBy.validated
        return ChosenBy.reestimated if self.chosen_by else ChosenBy.fitness

    @property
    def where(self) -> str:
        """The settings of data that differ from the run's, as `split_seed=7`; empty where none does."""
        return ", ".join(assignments(self.other_data))

    @property
    def trained_with(self) -> str:
        """The settings of training that differ from the run's, as `numerics=fast`; empty where none does."""
        return ", ".join(assignments(self.other_device))

    @property
    def apart(self) -> str:
        """Say both in sentences; empty where nothing differs."""
        said = {"On other data than the run's": self.where, "Trained with other settings": self.trained_with}
        return " ".join(f"{what}: {settings}." for what, settings in said.items() if settings)


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyRecord(Design):
    """The content of study.json."""

    schema: Literal[2]
    name: str
    #: Units of the labels for one unit of training, and their names; empty for classification.
    scale: tuple[float, ...]
    units: tuple[str, ...]
    versions: dict[str, str]
    machine: dict[str, FreeJson]
    #: The last hash of the scores; None until the study is finished.
    digest: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyHeader(Design):
    """The first line of the scores."""

    schema: Literal[2]
    kind: Literal["study"] = "study"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreLine(Record):
    """The scores of one network that was trained with one seed."""

    network: str
    id: str
    #: 0 to S - 1.
    seed: int
    #: Key of the training in the store, which holds the losses of every epoch.
    evaluation: str
    #: The epoch of the lowest validation loss, from 1; of a noise run the last, unless the lowest is the fitness.
    epoch: int
    #: The validation loss after that epoch; of a noise run the fitness.
    validation_loss: float
    #: The test metrics by name; empty where nothing is tested.
    metrics: dict[str, float]
    #: The number of test images by (true class, predicted class); None for regression, and where nothing is tested.
    confusion: tuple[tuple[int, ...], ...] | None
    predictions: str
    weights: str
    not_deterministic: tuple[str, ...] = ()
    #: True where its steps were recorded once on a GPU and replayed; None on a CPU.
    captured: bool | None = None
    #: The test predictions in the store; None where nothing is tested, and under the rules before
    #: `tacevo.rules.KEPT_SINCE`.
    kept: StoredPredictions | None = None
    kind: Literal["score"] = "score"


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedLine(Record):
    """The reason for which the training of one network with one seed failed."""

    network: str
    id: str
    seed: int
    evaluation: str
    stage: Stage
    reason: Reason
    kind: Literal["score"] = "score"


Row = ScoreLine | FailedLine


def study_line_kind(entry: Mapping[str, Json]) -> type[StudyHeader | ScoreLine | FailedLine] | None:
    """Return the class of a line of scores.jsonl; None where a study writes no such line."""
    if entry.get("kind") == "study":
        return StudyHeader
    return FailedLine if "reason" in entry else ScoreLine


def is_late(score: ScoreLine, epochs: int) -> bool:
    """Return whether the best epoch of a training of so many epochs lies in its last tenth: more might be better."""
    return 10 * score.epoch > 9 * epochs  # in integers


def fewest_seeds(alpha: float) -> int:
    """Return the least S for which a two-sided rank test of S values against S can be significant at a level alpha.

    Of the C(2S, S) orders, which are equally likely without a difference, the two extreme ones have the smallest p.
    """
    return next(seeds for seeds in itertools.count(1) if rounded(2 / math.comb(2 * seeds, seeds)) <= alpha)


def fewest_groups(alpha: float) -> int:
    """Return the least number of groups of test images whose two-sided signed-rank test can be significant at a level.

    Of the 2^n assignments of signs, which are equally likely without a difference, the two extreme ones have the
    smallest p.
    """
    return next(groups for groups in itertools.count(1) if rounded(2 / 2**groups) <= alpha)
