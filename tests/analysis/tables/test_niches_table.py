"""Promise: the table of niches counts those of the archive, those that a run could reach, and those that it filled."""

from dataclasses import replace

import numpy as np
from hand_runs import closed, configured, elite, prompt_trial, rejected, run, trained

from analysis.runs.niches import Niches
from analysis.table import Percent
from analysis.tables.niches import niches_table

#: Four niches, one in each quarter of the unit square.
QUARTERS = np.array([[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])

CORNERS = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))

#: Four niches over two instructions, below and above a temperature of 0.5.
PROMPTS = np.array([[0.0, 0.25], [1.0, 0.25], [0.0, 0.75], [1.0, 0.75]])


def test_niches_are_counted_of_all_and_of_those_within_reach() -> None:
    """The rule of the paper only raises T from 0.6, so of four prompt niches the upper two count; one has a trial."""
    elites = [elite("g00s00", niche=0, fitness=0.5)]
    trial = prompt_trial(niche=2, prompt=0, temperature=0.6, inserted=True, curiosity=1.5)
    networks = [trained(0, slot, descriptors=point) for slot, point in enumerate(CORNERS)]
    lines = [closed(0, coverage=1.0), closed(1, coverage=0.25)]
    hand = replace(run(networks, lines, elites=elites), prompt_trials=(trial,))
    table = niches_table(hand, Niches(networks=QUARTERS, prompts=PROMPTS))
    head = ("archive", "niches", "occupied", "coverage", "reachable", "coverage of these", "effective", "lost")
    assert (table.columns, table.rows) == (
        head,
        (
            ("networks", 4, 1, Percent(0.25), 4, Percent(0.25), 4.0, 3),
            ("prompts", 4, 1, Percent(0.25), 2, Percent(0.5), None, None),
        ),
    )
    assert "temperature=paper can lead to in 1 generation (0.6 to 0.6)" in table.notes[-1]


def test_archive_that_a_run_lacks_has_no_row() -> None:
    """Neither one without niches nor one that was not kept; a run of generation 0 alone reaches no prompt niche."""
    bare = run([rejected(0, 0)], [closed(0, None, trained=0)], bounds=None)
    niches = Niches(networks=QUARTERS, prompts=PROMPTS)
    assert niches_table(bare, niches).rows == (("prompts", 4, 0, Percent(0.0), 0, None, None, None),)
    without = replace(bare, config=configured(prompts={"policy": "none"}))
    assert niches_table(without, niches).rows == ()
