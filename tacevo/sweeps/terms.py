"""The terms on which the arms of a sweep are compared: stated when it begins, and kept from then on.

docs/ablation_study.md says what each of them is for.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.choices import Primary, SplitRule, Varied
from tacevo.config.arms import NONE
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError, RunError
from tacevo.storage.plan_file import SeedPlan, read_plan
from tacevo.storage.sweep_directory import SweepDirectory, SweepTerms


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The request of a command about the terms of a sweep; None where it says nothing."""

    primary: Primary | None = None
    reference: str | None = None
    #: Sorted, each once.
    vary: tuple[Varied, ...] | None = None
    #: The plan.json that the sweep follows.
    plan: Path | None = None


def settled(directory: SweepDirectory, asked: Asked, config: RunConfig) -> SweepTerms:
    """Return the terms of a sweep: those that it began with, or, of one that is about to begin, those asked for.

    Args:
        directory: of the sweep.
        asked: what the command says of them.
        config: of one of its jobs.

    Raises:
        ConfigError: the plan cannot be read, or is not one for a sweep of this task; or test scores of networks that
            are looked up in a table, which has no test images, are asked for.
        RunError: it began on other terms, or sweep.json is damaged.
    """
    plan = None if asked.plan is None else read_plan(asked.plan, "sweep", config.task.name)
    if not directory.is_one:
        is_looked_up = config.data.facts.is_looked_up
        primary = asked.primary or (Primary.new_quartile if is_looked_up else Primary.test_score)
        if is_looked_up and primary.is_tested:
            expected = "another metric with data=table, which has no test images"
            raise ConfigError(primary, place="--primary", expected=expected)
        return SweepTerms(primary=primary, reference=asked.reference, vary=asked.vary or (), plan=plan)
    terms = directory.read().terms
    wanted = {"primary": asked.primary, "reference": asked.reference, "vary": asked.vary, "plan": plan}
    for name, value in wanted.items():
        stated = getattr(terms, name)
        if value is not None and value != stated:
            raise RunError(
                _in_words(value),
                place=f"{directory.path}/sweep.json, terms.{name}",
                expected=f"{_in_words(stated)}, as stated when the sweep began",
                remedy=f"leave --{name} out, or choose another --into; `tacevo ablations --reference` compares with "
                "any arm, and says so",
            )
    return terms


def with_reference(terms: SweepTerms, arms: Collection[str]) -> SweepTerms:
    """Return terms that name the reference, where an arm of the sweep can be it.

    Raises:
        ConfigError: the reference that they name is not an arm of the sweep.
    """
    if terms.reference is None:
        return replace(terms, reference=NONE if NONE in arms else None)
    if terms.reference not in arms:
        expected = f"one of the arms: {', '.join(map(repr, sorted(arms)))}"
        raise ConfigError(repr(terms.reference), place="--reference", expected=expected)
    return terms


def read_varied(text: str) -> tuple[Varied, ...]:
    """Read what a user wrote for `--vary`: keys of settings, with commas between them; sorted, each once.

    Raises:
        ConfigError: it is not a setting that a job may take from its seed.
    """
    known = [key.value for key in Varied]
    for key in text.split(","):
        if key not in known:
            raise ConfigError(
                repr(key), place="--vary", expected=f"one or more of {', '.join(known)}, with commas between them"
            )
    return tuple(sorted(map(Varied, set(text.split(",")))))


def check_varied(config: RunConfig, vary: Collection[Varied], overrides: Sequence[str]) -> None:
    """Check that the settings that a job takes from its seed have an effect, and are set by nothing else.

    Raises:
        ConfigError: one has none, or an override sets it.
    """
    written = {override.partition("=")[0] for override in overrides}
    for key in vary:
        if key in written:
            expected = "a setting that no override sets, since it is the seed of each job"
            raise ConfigError(f"{key}, which an override sets", place="--vary", expected=expected)
        if key is Varied.splitting:
            holds, needed = config.data.split is SplitRule.random, "data.split=random"
        else:
            holds, needed = config.data.facts.is_made, "simulated data"
        if not holds:
            raise ConfigError(f"{key} without {needed}", place="--vary", expected="a setting that has an effect")


def describe_terms(terms: SweepTerms) -> str:
    """Write the terms of a sweep in a line."""
    stated = {
        "primary": terms.primary,
        "reference": terms.reference,
        "the seed of each job": ",".join(terms.vary) or None,
        "planned": terms.plan
        and f"{terms.plan.seeds} jobs of each of {terms.plan.comparisons + 1} arms, {terms.plan.dated}",
        "tested with": terms.retraining and terms.retraining.settings,
    }
    return "terms: " + "; ".join(f"{name}: {value}" for name, value in stated.items() if value is not None)


def _in_words(value: object) -> str:
    if isinstance(value, SeedPlan):
        return f"the plan for {value.seeds} jobs of each arm"
    if isinstance(value, tuple):
        return ",".join(value) or "nothing"
    return "none stated" if value is None else repr(str(value))
