"""Test images that were recorded together: how they are counted, and whether a study should know of more of them."""

from tacevo.config.schema import RunConfig
from tacevo.config.sources import are_grouped
from tacevo.errors import RunError
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
    return not study.data.groups and _are_named(study, config) is True


def check_groups(study: Design, facts: DataFacts, config: RunConfig, place: str) -> None:
    """Check the groups of a study's test images by what its run says; `facts` and `config` are the run's.

    Raises:
        RunError: its data are the run's, whose groups are others; or no setting of its data names groups.
    """
    groups, expected = study.data.groups, ""
    if facts.groups and study.data.fingerprint == facts.fingerprint and groups != facts.groups:
        expected = f"the {counted(facts.units, 'group')} of its run"
    elif groups and _are_named(study, config) is False:
        expected = "none, as the settings of its data name none"
    if expected:
        got = counted(study.data.units, "group") if groups else "none"
        raise RunError(got, place=f"{place}, data.groups", expected=expected, remedy="restore it, or study again")


def _are_named(study: Design, config: RunConfig) -> bool | None:
    """Answer whether the settings of a study's data name groups, as `are_grouped`."""
    return are_grouped({**to_json(config.data), **dict(study.other_data)}, config.task.name)
