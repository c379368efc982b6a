"""Runs that look their evaluations up in the table of a space: all that others know of tables."""

from dataclasses import replace
from pathlib import Path

from tacevo.config.schema import RunConfig


def with_table(
    config: RunConfig, digest: str, beside: Path, named: Path | None = None, *, option: str = ""
) -> RunConfig:
    """Return the configuration of a run with the place at which its table lies here; one without a table as it is.

    Raises:
        DataError, BundleError: as `tacevo.results.space_table.find_table`.
    """
    if not config.data.facts.is_looked_up:
        return config
    from tacevo.results.space_table import find_table

    table = find_table(Path(config.data.root or ""), digest, beside, named, option=option)
    return replace(config, data=replace(config.data, root=str(table)))
