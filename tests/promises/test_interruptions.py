"""Promise: kill -9 at any moment, as often as you like; the same command ends with the uninterrupted run's bytes.

What a kill leaves behind is gone in the end: no process lives on, no temporary file stays, MLflow shows the run once.
"""

import subprocess
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from interruptions import (
    CANDIDATES,
    Kill,
    Phase,
    draw_kills,
    ends,
    finish,
    kill,
    leftovers,
    mirrored,
    processes_of,
    results,
    start,
    unhurried,
)
from smallest import UNTRACKED

pytestmark = unhurried


def kill_until_finished(folder: Path, kills: list[Kill]) -> Counter[Phase]:
    """Search in a directory, killed again and again, until a session comes to its end; count the kills by phase.

    Those that struck are taken out of `kills`. One whose phase did not come any more goes to the end, for another
    search; a new search is killed while it makes its data, because none does that later.
    """
    kills.sort(key=lambda planned: planned.phase is not Phase.making)
    struck: Counter[Phase] = Counter()
    while kills:
        making_again = struck and kills[0].phase is Phase.making
        planned = kills.pop(-1 if making_again else 0)
        search = start(folder, *([] if planned.phase is Phase.mirroring else [UNTRACKED]))
        if not kill(search, folder, planned):
            kills.append(planned)
            expect_sound_end(search)
            break
        struck[planned.phase] += 1
    return struck


def expect_sound_end(search: subprocess.Popen[str]) -> None:
    """Expect success of a search that ended by itself."""
    _, errors = search.communicate()
    assert search.returncode == 0, errors


def expect_no_trace(folder: Path, digest: str, *, tracked: bool) -> None:
    """Expect that no process and no temporary file is left of a finished search, and that MLflow has it once."""
    assert ends(folder), processes_of(folder)
    assert leftovers(folder) == []
    if tracked:
        assert mirrored(folder / "mlflow.db") == (1 + CANDIDATES, digest)


def strike(counts: dict[Phase, int], root: Path, whole: tuple[Path, str], *, seed: int) -> Counter[Phase]:
    """Kill searches, a new one whenever one is finished, until every planned kill has struck; count them by phase.

    Each search gives the bytes of the uninterrupted one. What its kills left is looked at last: mirrors step back.
    """
    kills = draw_kills(counts, seed)
    struck: Counter[Phase] = Counter()
    searches: dict[Path, bool] = {}
    while kills:
        folder = root / f"search{len(searches)}"
        here = kill_until_finished(folder, kills)
        tracked = here[Phase.mirroring] > 0
        assert finish(start(folder, *([] if tracked else [UNTRACKED]))) == whole[1]
        assert results(folder) == results(whole[0])
        struck += here
        searches[folder] = tracked
        print(f"searches: {len(searches)}; kills: {struck.total()}; {dict(struck)}", flush=True)
    for folder, tracked in searches.items():
        expect_no_trace(folder, whole[1], tracked=tracked)
    return struck


QUICK = [Phase.evaluating, Phase.committing]
OTHERS = [phase for phase in Phase if phase not in QUICK]


@pytest.mark.parametrize("phases", [QUICK, pytest.param(OTHERS, marks=pytest.mark.slow)])
def test_one_kill_in_each_phase(phases: Iterable[Phase], tmp_path: Path, whole_search: tuple[Path, str]) -> None:
    """A search that is killed once in each phase ends as if nothing had happened."""
    counts = dict.fromkeys(phases, 1)
    assert strike(counts, tmp_path, whole_search, seed=1) == counts


@pytest.mark.long
@pytest.mark.timeout(4 * 3600)
@pytest.mark.parametrize("seed", [2, 3, 4, 5])
def test_fifty_kills(seed: int, tmp_path: Path, whole_search: tuple[Path, str]) -> None:
    """Fifty kills, some in every phase, in as many searches as that takes; with four seeds, two hundred."""
    counts = {
        Phase.whenever: 10,
        Phase.making: 3,
        Phase.completing: 9,
        Phase.admitting: 8,
        Phase.evaluating: 8,
        Phase.committing: 7,
        Phase.mirroring: 2,
        Phase.finishing: 3,
    }
    struck = strike(counts, tmp_path, whole_search, seed=seed)
    assert struck == counts
    assert struck.total() == 50
