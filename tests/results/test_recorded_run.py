"""Promise: a run.json that no run of this version wrote is refused, with what is wrong in it."""

from pathlib import Path
from typing import Any

import pytest
from ledger_lines import FACTS, run_record
from refusals import refused
from tacevo.results.settings import read_settings

from tacevo.config.compose import compose
from tacevo.config.plain import to_plain
from tacevo.errors import RunError
from tacevo.storage.run_directory import RunDirectory

DIRECTORY = RunDirectory(Path("run"))


@pytest.mark.parametrize("config", [{}, {"search": {"beams": 1}}])
def test_configuration_of_another_version_is_refused(config: dict[str, Any]) -> None:
    """Nothing of it is guessed, and no default taken."""
    with refused(RunError, place="run/run.json", expected="a configuration of this version", remedy="restore it"):
        read_settings(DIRECTORY, run_record(config=config))


def test_number_of_images_is_that_of_the_data_set() -> None:
    """Else a replay or a retraining would make another one."""
    config = to_plain(compose([f"data.images={sum(FACTS.counts) + 1}"]))
    with refused(RunError, place="run.json, data.images", expected=f"the {sum(FACTS.counts)} images", got="481"):
        read_settings(DIRECTORY, run_record(config=config))
