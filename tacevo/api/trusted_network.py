"""A candidate's network in this process, where its code runs unconfined."""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, cast

from tacevo.records import Contract

if TYPE_CHECKING:
    from torch import nn


def build(source: str, name: str, contract: Contract) -> "nn.Module":
    """Construct a candidate's network with fresh weights, drawn by torch's generator of this process.

    Raises:
        Exception: what the source raises.
    """
    torch = importlib.import_module("torch")  # here alone: commands and searches never import it
    module = ModuleType(name)
    sys.modules[name] = module  # where dataclasses, type hints and pickle look its names up
    module.__dict__.update(torch=torch, nn=torch.nn, F=torch.nn.functional, math=importlib.import_module("math"))
    exec(compile(source, f"<{name}>", "exec"), module.__dict__)
    return cast("nn.Module", contract.construct(module.__dict__[contract.class_name]))
