"""Entries of a sandbox in which candidates get all of Python: as if one had found a way past policy and guards.

What is tested with them is the process around a candidate, which must hold without any of these.
"""

import builtins

from tacevo.gate import honesty
from tacevo.gate.probe import run as probe
from tacevo.sandbox import candidate
from tacevo.training import trainer

__all__ = ["probe", "train"]


def _see_nothing(**_: object) -> None:
    """Stand for a check that a candidate has switched off."""


vars(candidate)["TEXTS_BUILTINS"] = vars(builtins)
for module in (candidate, honesty, trainer):
    vars(module)["check_shared"] = _see_nothing
train = trainer.run
