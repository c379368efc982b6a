"""Promise: a search gives the same bytes whatever is around it: workers, hash seed, language, time zone, place."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from interruptions import finish, results, start, unhurried

pytestmark = unhurried

#: Python as it was before it took every locale for UTF-8: whoever forgets to name an encoding gets ASCII.
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}

#: All that may differ, at once.
KATHMANDU = {
    "workers": 1,
    "environment": {**ASCII, "PYTHONHASHSEED": "1", "TZ": "Asia/Kathmandu"},
    "place": "an øther/place",
    "umask": 0o077,
}
CHATHAM = {
    "workers": 4,
    "environment": {"LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "random", "TZ": "Pacific/Chatham"},
    "umask": 0,
}

#: Each of them alone, so that a difference has a name; a locale that is not installed acts as C.
ALONE: list[dict[str, Any]] = [
    *({"workers": workers} for workers in (1, 4)),
    *({"environment": {"PYTHONHASHSEED": seed}} for seed in ("0", "12345", "4294967295", "random")),
    *({"environment": {"LC_ALL": name}} for name in ("C", "C.UTF-8", "de_DE.UTF-8", "tr_TR.UTF-8")),
    {"environment": ASCII},
    *({"environment": {"TZ": zone}} for zone in ("Asia/Kathmandu", "Pacific/Apia", "America/St_Johns")),
    *({"place": place} for place in ("elsewhere", "an øther/place")),
    *({"umask": umask} for umask in (0, 0o027, 0o077)),
]


@pytest.mark.parametrize(
    "around",
    [
        pytest.param(KATHMANDU, id="one worker in Kathmandu"),
        pytest.param(CHATHAM, id="four workers on Chatham", marks=pytest.mark.slow),
        *(pytest.param(one, id=str(one), marks=pytest.mark.long) for one in ALONE),
    ],
)
def test_what_is_around_a_search_may_differ(
    around: Mapping[str, Any], tmp_path: Path, whole_search: tuple[Path, str]
) -> None:
    """Nothing that is not in the configuration enters a result: digest and bytes are those of an ordinary search."""
    process = dict(around)
    settings = [f"executor.workers={process.pop('workers', 2)}", f"run.dir={tmp_path}/run"]
    search = start(tmp_path, "tracking=none", *settings, f"store.root={tmp_path}/cache", **process)
    assert finish(search) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])
