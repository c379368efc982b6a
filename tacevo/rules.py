"""The rules that results are made under: a number for each part of the code whose change may change a result.

The first line of a ledger records the numbers of its run. A replay reads the stores under the recorded numbers, so
recorded verdicts, profiles and trainings outlive the code that made them. Raise a number in `CURRENT` with every change
of its part that may give another answer; docs/publishing.md says what a raise costs the users.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from tacevo.errors import RunError
from tacevo.records import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules(Record):
    """What decides the results of a search, beside its configuration."""

    #: Extraction and policy; part of the key of every verdict on an answer.
    static: int
    #: Probe and tracer; part of the key of every profile.
    probe: int
    #: Trainer and judgement of its answer; part of the key of every evaluation.
    training: int
    #: The pure core: descriptors, archives, temperature, prompts, proposals. Every replay computes it again.
    #: From 2 on, a candidate's line names the sampling settings that were not sent.
    core: int


#: Rules of the runs whose ledgers record none: those of the first published runs.
FIRST = Rules(static=1, probe=4, training=1, core=1)

#: Rules that this code follows.
CURRENT = Rules(static=4, probe=8, training=5, core=2)

#: Numbers of the core that this code can compute. Remove one only with its last release in `LAST_RELEASES`.
CORES = frozenset({1, 2})

#: Numbers of training whose bits this code's trainer gives, so that `--retrain` can compare them. Number 1
#: is reproduced only for candidates that today's policy admits. A class that redefined methods of nn.Module was
#: trained with its own methods then.
TRAININGS = frozenset({1, 2, 3, 4, 5})

#: Numbers under which the networks of the grammar's space have the verdicts, profiles and trainings of today, so that a
#: table made under them can be searched. A test measures each network of the published table again.
LIKE_TODAY: Mapping[str, frozenset[int]] = {
    "static": frozenset({3, CURRENT.static}),
    "probe": frozenset({6, 7, CURRENT.probe}),
    "training": frozenset({4, CURRENT.training}),
}

#: Those of them whose images keep torch's default memory layout.
CONTIGUOUS = frozenset({1, 2})

#: Those of them whose square roots and inverse trigonometric functions are MKL's, whose bits follow the CPU.
MKL_FUNCTIONS = frozenset({1, 2, 3, 4})

#: Those of them that ran every step eagerly on a GPU, too.
EAGER = frozenset({1, 2, 3, 4})

#: The last release that has what this code has dropped, by part and number.
LAST_RELEASES: Mapping[tuple[str, int], str] = {}

#: Number of full trainings of studies that record none, and the number that this code follows.
FIRST_STUDY = 2

STUDY = 7

#: The number of training whose bits the full trainings of each number have.
TRAININGS_OF_STUDIES: Mapping[int, int] = {2: 1, 3: 2, 4: 3, 5: 4, 6: 4, 7: 5}

#: The first number of studies that keep their test predictions.
KEPT_SINCE = 5

#: The first number of studies that predict the test images with the weights of the chosen epoch alone.
CHOSEN_SINCE = 6

#: Number of summaries and tables of runs that record none, and the number that this code writes. They follow from the
#: records and decide nothing, so a replay compares the texts of its own number only.
FIRST_PAGES = 1

PAGES = 8


def check_known(part: str, number: int, known: Collection[int], place: object) -> None:
    """Check that this code can still compute what a run was made with, by a part: `core`, `training` or `study`.

    Raises:
        RunError: it cannot; the message names the release that can, and how to get it.
    """
    if number in known:
        return
    release = LAST_RELEASES.get((part, number))
    remedy = (
        "a later release made it: update tacevo"
        if release is None
        else f"release {release} can compute it: git checkout v{release} && make setup"
    )
    raise RunError(
        str(number), place=str(place), expected=f"{part} rules {', '.join(map(str, sorted(known)))}", remedy=remedy
    )
