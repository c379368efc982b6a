"""Which candidates of a run are no new network: an answer that repeats what the model was given."""

from tacevo.evolution.lines import CandidateLine
from tacevo.gate.likeness import is_same_network
from tacevo.results.run import RecordedRun


def copies(run: RecordedRun) -> frozenset[str]:
    """Find the candidates that are the network of one of their parents, by id.

    They may be written with other comments, docstrings or layout. A source whose file is missing, or was edited, is
    compared with none but those of its hash.
    """
    known = {candidate.id: candidate for candidate in run.candidates}
    return frozenset(
        candidate.id
        for candidate in run.candidates
        if candidate.source is not None
        and any(_is_copy(run, candidate, known[parent]) for parent in candidate.parents if parent in known)
    )


def _is_copy(run: RecordedRun, child: CandidateLine, parent: CandidateLine) -> bool:
    """Return whether two candidates are one network; those of unlike profiles are not, and their texts are not read."""
    if child.source == parent.source:
        return True
    if parent.source is None or (child.parameters, child.flops) != (parent.parameters, parent.flops):
        return False
    texts = [run.directory.read_checked(line.id, line.source) for line in (child, parent)]
    first, second = (None if is_edited or text is None else text.decode() for text, is_edited in texts)
    return first is not None and second is not None and is_same_network(first, second)
