"""What was planned and not sent to a model, because the model refuses it, as ledger lines say; pure."""

from collections import Counter
from collections.abc import Collection, Sequence

#: The sampling setting that a search adapts.
TEMPERATURE = "temperature"


def not_sent(dropped: Sequence[Collection[str]]) -> dict[str, str]:
    """Say which sampling settings were not sent, as in `temperature was not sent: the model refuses it`.

    What was dropped are the settings that each request of a run was sent without. Return the words by setting, in the
    order of names, with the number of requests where it is not all of them.
    """
    missed = Counter(setting for settings in dropped for setting in settings)
    parts = {
        setting: "" if missed[setting] == len(dropped) else f" with {missed[setting]} of {len(dropped)} requests"
        for setting in sorted(missed)
    }
    return {setting: f"{setting} was not sent{part}: the model refuses it" for setting, part in parts.items()}
