"""Test images that were recorded together: how they are counted, and whether a study should know of more of them."""

from tacevo.config.schema import RunConfig
from tacevo.config.sources import are_grouped
from tacevo.records import DataFacts, to_json
from tacevo.results.study_lines import Design, fewest_groups
from tacevo.text import counted

#: Fewer groups of test images than these show nothing by a single test at 0.05, and intervals over them are too narrow.
FEWEST = fewest_groups(0.05)


def images_tested(facts: DataFacts, noun: str = "test image") -> str:
    """Count the test images, and their groups where some share one: `45 test images of 15 groups`."""
    images = counted(facts.counts[2], noun)
    return f"{images} of {counted(facts.units, 'group')}" if facts.is_grouped else images


def in_groups(facts: DataFacts) -> str:
    """Return what stands behind a number of test images, ` (of 15 groups)`; nothing where none share a group."""
    return f" (of {counted(facts.units, 'group')})" if facts.is_grouped else ""


def lacks_groups(study: Design, config: RunConfig) -> bool:
    """Return whether the settings of a study's data name groups, and it does not record them: an earlier release."""
    settings = {**to_json(config.data), **dict(study.other_data)}
    return not study.data.groups and are_grouped(settings, config.task.name) is True
