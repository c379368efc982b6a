"""Promise: a search gives the same bytes whatever is around it: workers, hash seed, language, time zone, place."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest
from interruptions import finish, results, start, unhurried

pytestmark = unhurried

#: Python as it was before it took every locale for UTF-8: whoever forgets to name an encoding gets ASCII.
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Around:
    """What is around a search."""

    workers: int = 2
    environment: dict[str, str] = field(default_factory=dict)
    #: The working directory, below the directory of the run and the stores.
    place: str = "."
    umask: int = 0o022


def expect_same(around: Around, folder: Path, whole: tuple[Path, str]) -> None:
    """Search from nothing, and expect the digest and every byte of a search under ordinary circumstances."""
    search = start(
        folder,
        "tracking=none",
        f"executor.workers={around.workers}",
        f"run.dir={folder}/run",
        f"store.root={folder}/cache",
        environment=around.environment,
        place=around.place,
        umask=around.umask,
    )
    assert finish(search) == whole[1]
    assert results(folder) == results(whole[0])


@pytest.mark.parametrize(
    "around",
    [
        pytest.param(
            Around(
                workers=1,
                environment={**ASCII, "PYTHONHASHSEED": "1", "TZ": "Asia/Kathmandu"},
                place="an øther/place",
                umask=0o077,
            ),
            id="one worker in Kathmandu",
        ),
        pytest.param(
            Around(
                workers=4,
                environment={"LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "random", "TZ": "Pacific/Chatham"},
                umask=0,
            ),
            id="four workers on Chatham",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_everything_around_a_search_may_differ_at_once(
    around: Around, tmp_path: Path, whole_search: tuple[Path, str]
) -> None:
    """Nothing that is not in the configuration enters a result."""
    expect_same(around, tmp_path, whole_search)


@pytest.mark.long
@pytest.mark.parametrize(
    "around",
    [
        *(Around(workers=workers) for workers in (1, 4)),
        *(Around(environment={"PYTHONHASHSEED": seed}) for seed in ("0", "12345", "4294967295", "random")),
        *(Around(environment={"LC_ALL": name}) for name in ("C", "C.UTF-8", "de_DE.UTF-8", "tr_TR.UTF-8")),
        Around(environment=ASCII),
        *(Around(environment={"TZ": zone}) for zone in ("Asia/Kathmandu", "Pacific/Apia", "America/St_Johns")),
        *(Around(place=place) for place in ("elsewhere", "an øther/place")),
        *(Around(umask=umask) for umask in (0, 0o027, 0o077)),
    ],
    ids=str,
)
def test_one_thing_around_a_search_differs(around: Around, tmp_path: Path, whole_search: tuple[Path, str]) -> None:
    """Each of them alone, so that a difference has a name; a locale that is not installed acts as C."""
    expect_same(around, tmp_path, whole_search)
