"""Hostile candidates on their three ways: through the whole gate, or past the policy into the probe or the training."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from gate_cases import VALID, completion, contract
from numpy.typing import NDArray

from tacevo.choices import Numerics
from tacevo.gate.admission import Gate, GateLimits
from tacevo.profile import Admitted
from tacevo.records import Limits, Mode, Recipe, Rejection, Training
from tacevo.rules import CURRENT
from tacevo.sandbox.client import Sandbox
from tacevo.storage.store import Store
from tacevo.training.evaluation import Evaluator, Examples, Setting
from tacevo.training.numerics import environment

CONTRACT = contract("force", 32)
LIMITS = Limits(seconds=6, memory_mib=1_000)
GATE_LIMITS = GateLimits(parameters=20_000_000, flops=10**10, modules=500)
RECIPE = Recipe(epochs=2, batch_size=16, learning_rate=1e-3, optimiser="adam", limits=LIMITS)


def examples() -> tuple[NDArray[np.uint8], Examples]:
    """Make 48 images of noise, 32 to train on, with labels that no candidate can know."""
    rng = np.random.default_rng(5)
    targets = rng.standard_normal((48, 3)).astype(np.float32)
    rows = np.arange(48)
    return rng.integers(0, 256, (48, 3, 32, 32), dtype=np.uint8), Examples(
        train=rows[:32],
        validation=rows[32:],
        train_targets=targets[:32],
        validation_targets=targets[32:],
        mean=(127.5,) * 3,
        deviation=(74.0,) * 3,
        fingerprint="noise",
    )


@dataclass(frozen=True, slots=True)
class Harness:
    """Gate and training over one sandbox, with stores that keep nothing from one candidate to the next.

    Args:
        sandbox: with the entries of gate and training, and the array `images`.
        data: its labels.
        folder: for the stores.
        limits: of each probe and training.
    """

    sandbox: Sandbox
    data: Examples
    folder: Path
    limits: Limits = LIMITS

    def through_the_gate(self, text: str) -> Training | Rejection:
        """Judge an answer as a search does, and train it if it is admitted."""
        verdict = self._gate().admit(completion(text))
        return self.trained(verdict.source) if isinstance(verdict, Admitted) else verdict

    def probed(self, source: str) -> Admitted | Rejection:
        """Probe a source without asking the policy."""
        return self._gate().measure(source)

    def trained(self, source: str) -> Training | Rejection:
        """Train a source that neither the policy nor the probe has seen."""
        store = Store(self.folder, "evaluations", Mode.live)
        recipe, data = replace(RECIPE, limits=self.limits), self.data
        setting = Setting(contract=CONTRACT, fingerprint=data.fingerprint, recipe=recipe, numerics=Numerics.portable)
        return Evaluator(run=self.sandbox.run, store=store, setting=setting, examples=data, rules=0).evaluate(source, 0)

    def good_one(self) -> Training | Rejection:
        """Train a decent candidate: what it gives must not depend on who was there before."""
        return self.trained(VALID)

    def _gate(self) -> Gate:
        return Gate(
            run=self.sandbox.run,
            store=Store(self.folder, "probes", Mode.live),
            answers=Store(self.folder, "answers", Mode.live),
            contract=CONTRACT,
            limits=GATE_LIMITS,
            probe_limits=self.limits,
            numerics=Numerics.portable,
            rules=CURRENT,
        )


def open_sandbox(images: Path) -> Sandbox:
    """Open a sandbox as a search does, with all the walls that the kernel has, and with no guard inside it."""
    entries = {"probe": "unguarded:probe", "train": "unguarded:train"}
    return Sandbox(entries=entries, environment=environment(Numerics.portable), arrays={"images": images})
