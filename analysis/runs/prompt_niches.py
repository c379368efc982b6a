"""Which niches of the prompt archive a run could reach: its temperature rule leads to few of the temperatures."""

import numpy as np
from numpy.typing import NDArray

from tacevo.evolution.archive import Tessellation
from tacevo.evolution.prompts import prompt_point
from tacevo.evolution.temperatures import clip
from tacevo.parts import Generation
from tacevo.parts.kinds import TEMPERATURES
from tacevo.parts.registry import of_settings
from tacevo.results.run import RecordedRun


def reachable_temperatures(run: RecordedRun) -> frozenset[float]:
    """Return every T_g that a trial of the run could have had, with any fitness that its generations found.

    A generation brings a better best or the same. Trials begin with generation 1, at T_1; the noise of a request does
    not enter the prompt archive. Of a rule that a user brought, nobody knows what else it could have said: these are
    the temperatures that it had.
    """
    settings = run.config.temperature
    if settings.rule not in TEMPERATURES.ours:
        return frozenset(line.temperature for line in run.generations[1:])
    rule = of_settings(TEMPERATURES, settings.rule, settings)
    reached: set[float] = set()
    current = {settings.start}
    for _ in range(run.generations[-1].generation):
        reached |= current
        current = {clip(rule.next(_ended(before, best))) for before in current for best in (0.5, 1.0)}
    return frozenset(reached)


def _ended(temperature: float, best: float) -> Generation:
    """Return a generation that found this best after one of 1."""
    counts = {"candidates": 1, "trained": 1, "inserted": 1}
    return Generation(number=1, temperature=temperature, best=best, best_before=1.0, **counts)


def reachable_prompt_niches(run: RecordedRun, centroids: NDArray[np.float64]) -> frozenset[int]:
    """Return the niches that hold some instruction at one of `reachable_temperatures`.

    The centroids are those of the prompt archive, shape (niches, 2), in [0, 1].
    """
    prompts = len(run.instructions)
    points = [
        prompt_point(prompt, temperature, prompts=prompts)
        for prompt in range(prompts)
        for temperature in reachable_temperatures(run)
    ]
    return frozenset(Tessellation(centroids).niches_of(points))
