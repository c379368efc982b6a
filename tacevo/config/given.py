"""Networks that a user gives: their files, and the run that a study of them is about."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

from tacevo.choices import PAPER_AXES
from tacevo.config.checks import check_together
from tacevo.config.compose import compose, compose_study
from tacevo.config.network_files import read_networks
from tacevo.config.schema import RunConfig, SearchConfig
from tacevo.config.study import StudyConfig
from tacevo.errors import ConfigError
from tacevo.records import Given

#: Settings of a study, by their first part; `run` is the directory of another one's run.
_OF_A_STUDY = {field.name for field in fields(StudyConfig)} - {"run"}

#: Settings of the run, by their first part: how given networks are trained, judged and recorded. Both have the last
#: two.
_OF_A_RUN = {
    *("task", "data", "training", "numerics", "gate", "sandbox", "seed", "experiment", "tracking", "run"),
    *("executor", "store"),
}


def gives_networks(overrides: Sequence[str]) -> bool:
    """Return whether the settings of a study are about given networks, or about a task's baseline alone."""
    keys = {override.partition("=")[0] for override in overrides}
    return not keys & {"run", "sweep"} and any(
        key == "networks" or _group(key) in {"task", "experiment"} for key in keys
    )


def compose_given(overrides: Sequence[str]) -> tuple[StudyConfig, RunConfig, dict[Path, Given]]:
    """Compose a study of given networks, and the run that they stand in: one of generation 0, which keeps them all.

    The overrides are those of a study, such as `networks=DIR`, and those of a run, such as `task=force`.

    Raises:
        ConfigError: as `tacevo.config.compose.compose`; a setting is that of a search; no task is named; or the files
            are not networks of different names.
    """
    check_unchosen(overrides)
    keys = {override: override.partition("=")[0] for override in overrides}
    for override, key in keys.items():
        if _group(key) not in _OF_A_STUDY | _OF_A_RUN:
            known = ", ".join(sorted(_OF_A_RUN - _OF_A_STUDY))
            raise ConfigError(override, place=key, expected=f"a setting of a study, or of its run: of {known}")
    if not {"task", "experiment"} & set(keys.values()):
        expected = "the task of the networks"
        raise ConfigError("no task", place="task", expected=expected, remedy="add it, as in task=force")
    of_study = [override for override, key in keys.items() if _group(key) in _OF_A_STUDY]
    of_run = [override for override, key in keys.items() if _group(key) in _OF_A_RUN]
    study = compose_study(of_study, given=True)
    files = read_networks(study.networks)
    chosen = compose(["llm=grammar", *of_run])  # it is asked nothing, but some experiments want a model to be named
    return study, _run_of(chosen, len(files)), files


def check_unchosen(overrides: Sequence[str]) -> None:
    """Raise ConfigError where the settings of a study of given networks choose elites among them."""
    for override in overrides:
        key = override.partition("=")[0]
        if key in {"elites", "choose"}:
            raise ConfigError(override, place=key, expected="no choice of elites: every given network is studied")


def _run_of(chosen: RunConfig, networks: int) -> RunConfig:
    """Turn a configuration into that of a run that holds the baseline and so many other networks."""
    config = replace(
        chosen,
        search=SearchConfig(generations=0, candidates=1, initial=networks),
        archive=replace(chosen.archive, kind="best", kept=networks + 1, axes=PAPER_AXES),
        prompts=replace(chosen.prompts, policy="none", pool=None),
    )
    check_together(config)
    return config


def _group(key: str) -> str:
    return key.partition(".")[0]
