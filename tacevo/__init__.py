"""TacEvo: architecture search for vision-based tactile sensors that can be replayed bit for bit.

`tacevo.open` reads what was recorded; `tacevo.search`, `extend`, `study`, `noise`, `plan`, `publish`, `check` and
`check_data` do what the commands of these names do. docs/python.md lists columns, units and shapes.
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "1.0.0"

#: The public names, each with its module, which is imported when the name is used: torch and pandas take seconds.
_PLACES = {
    "open": "api.opening",
    "open_table": "api.space_tables",
    "check": "api.checks",
    "check_data": "api.checks",
    "search": "api.actions",
    "extend": "api.actions",
    "plan": "api.planning",
    "study": "api.actions",
    "noise": "api.actions",
    "publish": "api.actions",
    "Run": "api.runs",
    "Study": "api.studies",
    "Sweep": "api.sweeps",
    "Table": "api.tables",
    "TacevoError": "errors",
    "ConfigError": "errors",
    "RunError": "errors",
    "BundleError": "errors",
    "DivergenceError": "errors",
    "CacheMissError": "errors",
}

if TYPE_CHECKING:
    from tacevo.api.actions import extend, noise, publish, search, study
    from tacevo.api.checks import check, check_data
    from tacevo.api.opening import open
    from tacevo.api.planning import plan
    from tacevo.api.runs import Run
    from tacevo.api.space_tables import open_table
    from tacevo.api.studies import Study
    from tacevo.api.sweeps import Sweep
    from tacevo.api.tables import Table
    from tacevo.errors import BundleError, CacheMissError, ConfigError, DivergenceError, RunError, TacevoError

__all__ = [
    "BundleError",
    "CacheMissError",
    "ConfigError",
    "DivergenceError",
    "Run",
    "RunError",
    "Study",
    "Sweep",
    "Table",
    "TacevoError",
    "check",
    "check_data",
    "extend",
    "noise",
    "open",
    "open_table",
    "plan",
    "publish",
    "search",
    "study",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module 'tacevo' has no attribute {name!r}")
    from tacevo.parts.registry import needing_parts

    with needing_parts():
        return getattr(importlib.import_module(f"tacevo.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
