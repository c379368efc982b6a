"""The static half of the gate: from a model's raw answer to source text that the policy lets through.

What it promises: the verdict on an answer is recorded once and recalled from then on. It depends on the grammar of
the Python that reached it (3.12 parses text that 3.11 refuses), so a replay that judged anew could disagree with its
recording.
"""

from tacevo.gate.extraction import extract, first_look
from tacevo.gate.policy.check import check
from tacevo.records import Completion, Contract, Rejection, to_json
from tacevo.storage.store import Store
from tacevo.storage.verdicts import recall_verdict


def read(completion: Completion, contract: Contract, *, limit: int, store: Store, rules: int) -> str | Rejection:
    """Find the source in an answer and hold it against the policy.

    Args:
        completion: the answer as the model gave it.
        contract: names the class to look for.
        limit: most UTF-8 bytes that an answer may have.
        store: where verdicts are kept, of kind `answers`. What needs no parsing is never kept: such an answer may be
            huge, or text that no file can hold.
        rules: number of extraction and policy (`tacevo.rules.Rules.static`), part of the verdict's key.

    Returns:
        Source that may go on to the probe, or a rejection at stage `extract` or `policy`.

    Raises:
        CacheMissError: the store only replays and does not know this answer.
        StoreError: the entry is damaged.
    """
    rejection = first_look(completion, limit=limit)
    if rejection is not None:
        return rejection
    request = {
        "version": rules,
        "text": completion.text,
        "stop_reason": completion.stop_reason,
        "contract": to_json(contract),
        "limit": limit,
    }
    return recall_verdict(store, request, str, "source", lambda: _judged(completion, contract, limit))


def _judged(completion: Completion, contract: Contract, limit: int) -> str | Rejection:
    """Extract the source and check it."""
    source = extract(completion, contract, limit=limit)
    return source if isinstance(source, Rejection) else check(source, contract) or source
