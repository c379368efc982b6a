"""What tables say of the temperatures of a grammar, and of what carries temperatures."""

from collections.abc import Sequence

from tacevo.results.run import RecordedRun

#: Said wherever temperatures of a grammar are compared.
GRAMMAR_TEMPERATURE = (
    "The grammar's temperature is a mutation strength, the number of random edits beside the instruction, and not the "
    "sampling temperature of a model."
)


def grammar_note(runs: Sequence[RecordedRun]) -> tuple[str, ...]:
    """Say what a temperature is where the grammar answered."""
    return (GRAMMAR_TEMPERATURE,) if any(not run.config.llm.facts.is_model for run in runs) else ()


def carrier_notes(runs: Sequence[RecordedRun]) -> tuple[str, ...]:
    """Say what temperatures choose where they are not sent as such, a sentence for each way."""
    return tuple(dict.fromkeys(run.carrier_note for run in runs if run.carrier_note))
