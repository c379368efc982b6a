"""What a noise run found, on one screen: one table, and in a line each what to beware of."""

from collections.abc import Sequence

from analysis.rounding import shown
from analysis.statistics.effects import LEVEL, superiority
from analysis.studies.noise import SeedNoise
from analysis.studies.reestimates import Reestimates
from analysis.table import Interval, Table
from analysis.tables.noise import BEATS, chance_note
from tacevo.text import counted, listed

#: How many networks of a noise run are listed: the baseline, the best on record, and the best of the re-estimates.
MOST = 10

_TOGETHER = (
    f"Better and worse: by intervals that hold for all elites together with {100 * LEVEL:g} %, and so are wider than "
    "those of the table."
)


def noise_outcome(again: Reestimates, task: str, trivial: float | None) -> Table:
    """Show what a noise run found: the recorded fitness of its networks beside what other seeds give.

    `trivial` is the trivial loss, where it is known; it has the last row.

    It begins with the finding in one sentence (`_finding`), unless the baseline was trained again alone.
    """
    noise = SeedNoise(again)
    known = noise.frame
    best = known[2:].sort_values("median", kind="stable").index[: MOST - 2]
    listed_ones = known.loc[[*known.index[:2], *sorted(best)]]
    seeds = counted(again.seeds, "other seed")
    how = "looked up in its table" if again.looked_up else "trained again as the search did,"
    trained = f"{task}: {counted(len(known), 'network')}, {how} with {seeds}"
    finding = _finding(noise)
    return Table.of(
        listed_ones,
        {"network": "network", "id": "candidate", "fitness, one draw": "recorded", "re-estimated": "median"}
        | {"least": "least", "most": "most", f"chance to beat the baseline [{100 * LEVEL:g} %]": BEATS},
        name="outcome",
        caption=trained if finding is None else finding,
        last=() if trivial is None else (("trivial", None, trivial, trivial, None, None, None),),
        notes=(
            *chance_note(again, trivial),
            *(() if finding is None else (f"{trained}.",)),
            *((_TOGETHER,) if len(known) > 2 else ()),
            *_undecidable(again),
            *_left_out(again, len(known) - len(listed_ones)),
            "Re-estimated: the median of these seeds. The lowest of many flatters its network too, if less.",
            _icc(noise.icc),
        ),
    )


def _finding(noise: SeedNoise) -> str | None:
    """Say how many networks are better than the baseline, which, and how many are not.

    That rests on the intervals of their chances to beat it, widened so that they hold for all of them together
    (Bonferroni).

    Returns:
        None where no other network than the baseline was trained with every seed.
    """
    again = noise.again
    baseline, *others = again.estimates
    if not others:
        return None
    chances = [superiority(values, baseline, level=_level(len(others))) for values in others]
    ranked = noise.frame[1:].assign(low=[chance.low for chance in chances]).sort_values("median", kind="stable")
    better = [f"{shown(one.median)} ({one.candidate})" for one in ranked[ranked.low > 0.5].itertuples()]
    worse = sum(chance.high < 0.5 for chance in chances)
    alike = len(others) - len(better) - worse
    rest = [f"{alike} cannot be told from it"] if alike else []
    rest += [f"{worse} {'is' if worse == 1 else 'are'} worse"] if worse else []
    seeds = f"{counted(again.seeds, 'seed')} that the search did not use"
    number, loss = len(better), shown(again.medians[0])
    if not better:
        can = f"{_named(int(len(others) == 1), len(others), again.failed)} {'cannot' if len(others) == 1 else 'can'}"
        return f"{can} be said to beat the baseline, whose median loss is {loss} over {seeds}: {' and '.join(rest)}."
    losses = f"{listed(better[:-1], most=MOST)} and {better[-1]}" if 1 < number <= MOST else listed(better, most=MOST)
    beat = f"{_named(number, len(others), again.failed)} {'beats' if number == 1 else 'beat'} the baseline"
    return f"{beat}: median loss {losses} against {loss}, over {seeds}{''.join(f'; {one}' for one in rest)}."


def _named(number: int, others: int, failed: Sequence[object]) -> str:
    """Name so many of the networks of a noise run, which are the best of the search that trained with every seed."""
    every = " that trained with every seed" if failed else ""
    if number == others == 1:
        return f"The search's best network{every}"
    if number == others:
        return f"{'Both' if number == 2 else f'All {number}'} of the search's best networks{every}"
    return f"{number or 'None'} of the search's {counted(others, 'best network')}{every}"


def _level(others: int) -> float:
    """Return the level of each interval at which so many hold together (Bonferroni)."""
    return 1 - (1 - LEVEL) / others


def _undecidable(again: Reestimates) -> tuple[str, ...]:
    """Say where so few seeds could not tell any of so many networks from the baseline."""
    seeds, others = again.seeds, len(again.networks) - 1
    if others < 1 or _can_tell(seeds, others):
        return ()
    ways = [*([] if again.looked_up else ["more seeds="]), *(["fewer elites="] if _can_tell(seeds, 1) else [])]
    advice = f": take {' or '.join(ways)}" if ways else ""
    return (
        f"{counted(seeds, 'seed')} cannot tell any of {counted(others, 'network')} from the baseline, however far "
        f"apart they are{advice}.",
    )


def _can_tell(seeds: int, others: int) -> bool:
    """Answer whether so many seeds can tell one of so many networks from the baseline, if it is far enough apart."""
    return superiority([0] * seeds, [1] * seeds, level=_level(others)).low > 0.5


def _left_out(again: Reestimates, unlisted: int) -> tuple[str, ...]:
    failed = listed(one.name for one in again.failed)
    return (
        *([f"Not listed: {unlisted} with a higher re-estimate; the tables have all."] if unlisted else []),
        *([f"Left out, because a training failed: {failed}."] if again.failed else []),
    )


def _icc(icc: Interval | None) -> str:
    if icc is None:
        return "No ICC: it takes two networks, two seeds, and losses above 0 that differ."
    part = f"{shown(icc)} ({100 * LEVEL:g} % interval)"
    return f"ICC {part}: the part of one fitness's variance that is the network's; the rest is the seed's."
