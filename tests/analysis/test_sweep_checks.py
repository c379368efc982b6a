"""Promise: runs of other data, budgets, versions or niches, and arms of two searches, are refused by name and value."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest
from hand_sweeps import SETTINGS, VERSIONS, finished, run_to, sweep_of

from analysis.sweeps.sweep import Finished
from analysis.sweeps.sweep_checks import VERSIONS as CHECKED
from analysis.sweeps.sweep_checks import check_sweep
from tacevo.errors import IncomparableError
from tacevo.records import Json
from tacevo.rules import FIRST
from tacevo.search.lines import RulesLine

RUN = run_to(0.5, 0.4)

#: Other rules than those of `RUN`.
CHANGED = replace(FIRST, static=9)


def changed(group: str, **fields: Json) -> Mapping[str, Json]:
    """Give one group of settings with changes."""
    return {group: {**SETTINGS[group], **fields}}


def beside(other: Finished) -> None:
    """Check a sweep of a job and another."""
    check_sweep(sweep_of([finished("none", 0, RUN), other]))


def test_arms_may_differ_in_how_they_search() -> None:
    """Temperature, prompts, proposals, model and kind of archive are what a sweep is about; places of runs are not."""
    searches = {"temperature": {"rule": "fixed"}, "prompts": {"policy": "none"}, "llm": {"model": "other"}}
    check_sweep(
        sweep_of(
            [
                finished("none", 0, RUN),
                finished("none", 1, RUN, settings={"store": {"root": "moved"}, "executor": {"workers": 9}}),
                finished("other", 0, RUN, settings=searches),
                finished("log", 0, RUN, settings=changed("archive", eff_ratio_scale="log", niches=9)),
            ]
        )
    )


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (changed("search", candidates=3), r"search\.candidates is 2 in none-seed0 and 3 in a-seed0\. Give all jobs"),
        (changed("search", initial=9), r"search\.initial is 1 in none-seed0 and 9 in a-seed0"),
        (changed("training", epochs=9), r"training\.epochs is 1 in none-seed0 and 9 in a-seed0"),
        (changed("training", device="cuda"), r'training\.device is "cpu" in none-seed0 and "cuda" in a-seed0'),
        (changed("task", name="grating"), r'task\.name is "force" in none-seed0 and "grating" in a-seed0'),
        (changed("numerics", kind="fast"), r'numerics\.kind is "portable" in none-seed0 and "fast" in a-seed0'),
        (changed("archive", niches=9), r"archive\.niches is 4 in none-seed0 and 9 in a-seed0\. Archives of one kind"),
        (changed("archive", seed=1), r"archive\.seed is 0 in none-seed0 and 1 in a-seed0"),
    ],
)
def test_other_settings_are_refused(settings: Mapping[str, Json], words: str) -> None:
    """The message has both jobs, the field, both values, and what to do."""
    with pytest.raises(IncomparableError, match=words):
        beside(finished("a", 0, RUN, settings=settings))


def test_other_data_are_refused() -> None:
    """By their fingerprint, wherever they lie."""
    other = replace(RUN, facts=replace(RUN.facts, fingerprint="cd"))
    with pytest.raises(IncomparableError, match=r'the data\'s fingerprint is "ab" in none-seed0 and "cd" in a-seed0'):
        beside(finished("a", 0, other))


def test_another_baseline_is_refused() -> None:
    """An improvement over another network would be another number."""
    first, *rest = RUN.candidates
    other = replace(RUN, candidates=(replace(first, source="another"), *rest))
    with pytest.raises(
        IncomparableError, match='the hash of the baseline\'s source is "g00s00" in none-seed0 and "another"'
    ):
        beside(finished("a", 0, other))


def test_another_number_of_generations_is_refused() -> None:
    """As the ledger has them: a continued run has more than it was begun with."""
    with pytest.raises(IncomparableError, match="the number of generations is 1 in none-seed0 and 2 in a-seed0"):
        beside(finished("a", 0, run_to(0.5, 0.4, 0.3)))


@pytest.mark.parametrize("package", CHECKED)
def test_other_versions_are_refused(package: str) -> None:
    """Of all that can change a result."""
    other = replace(finished("a", 0, RUN), versions={**VERSIONS, package: "2.0"})
    with pytest.raises(
        IncomparableError,
        match=rf'version of {package} is "1\.0" in none-seed0 and "2\.0" in a-seed0\. Delete.*store\.root',
    ):
        beside(other)


@pytest.mark.parametrize(
    ("eras", "words"),
    [
        ([RulesLine(generation=0, rules=CHANGED)], "static 9, probe 4, training 1, core 1"),
        (
            [RulesLine(generation=0, rules=FIRST), RulesLine(generation=1, rules=CHANGED)],
            "static 1, probe 4, training 1, core 1; from generation 1 static 9",
        ),
    ],
    ids=["begun", "continued"],
)
def test_other_rules_are_refused(eras: Sequence[RulesLine], words: str) -> None:
    """As the ledgers have them: one package version may have had several, and a continued run has two."""
    first = r'the set of rules is "static 1, probe 4, training 1, core 1" in none-seed0'
    with pytest.raises(IncomparableError, match=rf'{first} and "{words}" in a-seed0\. Delete'):
        beside(finished("a", 0, replace(RUN, eras=tuple(eras))))


def test_versions_that_change_no_result_may_differ() -> None:
    """A mirror of another version decides nothing."""
    beside(replace(finished("a", 0, RUN), versions={**VERSIONS, "mlflow": "9.9"}))


def test_arm_of_two_configurations_is_refused() -> None:
    """Median over seeds of two searches would be that of neither."""
    with pytest.raises(
        IncomparableError, match=r'temperature\.rule is "paper" in none-seed0 and "fixed" in none-seed1\. The runs'
    ):
        beside(finished("none", 1, RUN, settings=changed("temperature", rule="fixed")))
