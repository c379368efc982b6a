"""Promise: more workers than a machine has cores for are told."""

from dataclasses import replace

import pytest
from smallest import SMALLEST

from tacevo.config.compose import compose
from tacevo.environment import usable_cores
from tacevo.runs.local import crowded


@pytest.mark.parametrize(("for_each_core", "is_told"), [(1, False), (4, False), (100, True)])
def test_workers_without_cores_are_told(for_each_core: int, *, is_told: bool) -> None:
    """Some more may wait for a model's answers; a hundred times as many are a slip, or a wish that nothing grants."""
    config = compose(SMALLEST)
    workers = for_each_core * usable_cores()
    told = crowded(replace(config, executor=replace(config.executor, workers=workers)))
    assert [f"executor.workers={workers}" in sentence for sentence in told] == [True] * is_told
    elsewhere = replace(config.executor, kind="ray", workers=workers)
    assert crowded(replace(config, executor=elsewhere)) == []
