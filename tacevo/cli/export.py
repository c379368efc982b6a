"""The command `tacevo export`."""

import re
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from tacevo.api.opening import open_run
from tacevo.cli.common import DONE, existing_store, tell
from tacevo.errors import ConfigError
from tacevo.export.trainings import ExportSettings


def run_export(
    run: str, candidate: str, overrides: Sequence[str], output: str, *, store: str | None, retrained: bool
) -> int:
    """Write a network as a directory of its own."""
    other = [text for text in overrides if text.startswith("data.")]
    settings = _settings([text for text in overrides if text not in other])
    opened = open_run(run, store=existing_store(store))
    opened.export(candidate, output, *other, retrained=retrained, **settings)
    tell(f"{output}: README.md says how to use it")
    return DONE


def _settings(overrides: Sequence[str]) -> dict[str, Any]:
    """Read `KEY=VALUE` words."""
    known = [field.name for field in fields(ExportSettings)]
    settings: dict[str, Any] = {}
    for text in overrides:
        key, _, value = text.partition("=")
        if key not in known or key in settings or not value:
            expected = f"{', '.join([*known, 'data.root'])}, each once, as KEY=VALUE"
            raise ConfigError(text[:100], place="tacevo export", expected=expected, remedy="see tacevo export --help")
        settings[key] = int(value) if re.fullmatch(r"\d{1,9}", value) else value
    return settings
