"""Promise: a candidate that misreports itself is rejected with its reason, by its text or, past that, by the probe.

What looks alike and is honest is admitted.
"""

import builtins
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from door_sources import DOORS, Door
from doors import find_doors
from gate_cases import VALID, candidate, contract
from honest_sources import HONEST
from lying_sources import GOOD, LIES, RETURN, Lie

from tacevo.evolution.lines import MISREPORTING
from tacevo.gate.honesty import unchanged
from tacevo.gate.policy.check import rejection_of
from tacevo.gate.probe import run
from tacevo.records import Reason, to_json
from tacevo.sandbox import attributes, guards
from tacevo.sandbox.candidate import check_leaves

#: Reasons that lies have, too, and that are older than these rules.
OTHERS = {Reason.forbidden_construct, Reason.forbidden_name, Reason.construction_failed}

pytestmark = pytest.mark.usefixtures("torch_settings")

LIMITS = {"parameters": 10_000_000, "flops": 10**10, "modules": 100}


def probed(source: str) -> Any:
    """Probe a source whatever the policy says of it; return what is sent."""
    frames: list[Any] = []
    header = {"source": source, "contract": to_json(contract()), "limits": LIMITS}
    run(header, b"", {}, lambda frame, _: frames.append(frame))
    (answer,) = frames
    return answer


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES.keys())
def test_lie_that_stands_in_the_text_is_refused_by_the_policy(lie: Lie) -> None:
    """Each form of definition, assignment and change has its reason and its line; only text that hides it passes."""
    assert lie.policy or lie.probe, "whatever one of the two does not see, the other does"
    rejection = rejection_of(lie.source, contract())
    if lie.policy is None:
        assert rejection is None
    else:
        assert rejection is not None
        assert rejection.reason is lie.policy, rejection
        assert rejection.detail.startswith("line ")


@pytest.fixture
def unguarded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give candidates all of Python's own functions, as one would have that found a way to them."""
    monkeypatch.setattr("tacevo.sandbox.candidate.TEXTS_BUILTINS", vars(builtins))


@pytest.mark.usefixtures("unguarded")
@pytest.mark.parametrize("lie", LIES.values(), ids=LIES.keys())
def test_lie_past_the_policy_is_seen_by_the_probe(lie: Lie) -> None:
    """The probe asks the candidate nothing, so it needs no text to see what the candidate does."""
    answer = probed(lie.source)
    reason = Reason(answer["rejection"]["reason"]) if "rejection" in answer else None
    assert reason is lie.probe, answer


@pytest.mark.parametrize("source", HONEST.values(), ids=HONEST.keys())
def test_honest_candidate_is_admitted(source: str) -> None:
    """Initialisation, buffers, activations in place and reading the mode are what networks do."""
    assert rejection_of(source, contract()) is None
    assert "profile" in probed(source), probed(source)


@pytest.mark.room("grammar")
def test_grammar_is_honest() -> None:
    """Whatever the grammar provider can write passes the policy."""
    from grammar_forms import sources_of_grammar

    task = replace(contract(), class_name="Net")
    assert [rejection_of(source, task) for source in sources_of_grammar()] == [None] * len([*sources_of_grammar()])


#: Methods of `nn.Module` that convert or move it: a text may use their names, because nothing here calls them.
CONVERSIONS = frozenset({"bfloat16", "cpu", "cuda", "double", "float", "half", "ipu", "mtia", "type", "xpu"})


def test_list_of_names_is_that_of_torch() -> None:
    """The policy does not import torch, so its list is compared with the class: a new release may add names."""
    listed = {*dir(torch.nn.Module), *vars(torch.nn.Module())} - {"forward", "extra_repr"}
    special = {
        name for name in vars(torch.nn.Module) if name.startswith("__") and callable(vars(torch.nn.Module)[name])
    }
    plain = {name for name in listed if not name.startswith("__")}
    assert plain | special - {"__init__", "__repr__"} | {"__class__"} == attributes.MODULE_NAMES | CONVERSIONS
    assert not attributes.MODULE_NAMES & CONVERSIONS


def test_network_that_waits_is_not_seen() -> None:
    """What the text hides and the probe's passes do not show is admitted; docs/security.md says so."""
    patient = candidate(
        f"self.calls += 1\nif self.calls > 99:\n    for w in [self.conv.weight]:\n        w.neg_()\n{RETURN}",
        "self.calls = 0",
    )
    assert rejection_of(patient, contract()) is None
    assert "profile" in probed(patient)


@pytest.mark.usefixtures("unguarded")
def test_change_of_a_class_of_torch_is_seen() -> None:
    """A computed name reaches torch's own classes; each name must mean there what it meant before."""
    source = candidate(
        f"return self.drop({GOOD})",
        "self.drop = nn.Dropout(0.3)\n"
        "setattr(type(self.drop), 'train' + 'ing', property(lambda self: True, lambda self, value: None))",
    )
    assert rejection_of(source, contract()) is None
    try:
        answer = probed(source)
    finally:
        del torch.nn.Dropout.training
    assert answer["rejection"]["reason"] == Reason.redefines_module.value


def test_frozen_weights_outside_are_not_counted() -> None:
    """What does not learn is not a parameter, wherever it is kept; docs/security.md says so."""
    frozen = candidate(f"return {GOOD} @ self.mix", "self.mix = torch.randn(3, 3)")
    assert rejection_of(frozen, contract()) is None
    assert probed(frozen)["profile"]["parameters"] == probed(VALID)["profile"]["parameters"]


def test_weights_that_are_not_finite_are_the_same_weights() -> None:
    """Bits are compared, not values, and NaN is not equal to itself."""
    network = torch.nn.Linear(2, 2)
    torch.nn.init.constant_(network.weight, torch.nan)
    with unchanged(network, training=True) as listed:
        pass
    assert [*map(id, listed)] == [id(network.weight), id(network.bias)]


@pytest.fixture
def classes_of_torch() -> Iterator[None]:
    """Put back what a candidate changes of the classes that its process shares with these tests."""
    kinds = [torch.Tensor, torch.nn.Linear, torch.nn.Conv2d, torch.no_grad, Counter]
    before = [(kind, dict(vars(kind))) for kind in kinds]
    yield
    for kind, own in before:
        for name in vars(kind).keys() - own.keys():
            delattr(kind, name)
        for name, value in own.items():
            if vars(kind)[name] is not value:
                setattr(kind, name, value)


@pytest.mark.usefixtures("classes_of_torch")
@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS.keys())
def test_library_leads_nobody_out(door: Door) -> None:
    """What a library would look up, set or run for a text is refused there; the policy refuses what it can read."""
    rejection = rejection_of(door.source, contract())
    assert (None if rejection is None else rejection.reason) is door.policy
    answer = probed(door.source)
    assert answer.get("rejection", {}).get("reason") == door.probe, answer
    assert door.policy or door.probe


#: Modules of Python in which a text's own names are looked up, and why that leads nowhere.
CLOSED = {
    "collections": "`namedtuple` runs no name that is not an identifier",
    "copy": "guarded",
    "copyreg": "reads the slots of classes",
    "dataclasses": "guarded",
    "enum": "looks up members and written out names; `_convert_` is refused",
    "functools": "`wraps` may only decorate",
    "typing": "the policy allows no name that evaluates text; aliases read no special name",
    "typing_extensions": "not on the list; what torch's classes use of it is as in `typing`",
    "types": "made of attributes of its own",
    "reprlib": "shows",
    "contextlib": "calls what it was given",
}
#: Functions of torch that do so without a guard, and why that leads nowhere.
HARMLESS = {
    "torch.nn.functional.interpolate": "the name of a module of torch, written out",
    "torch.nn.functional.pad": "the name of a module of torch, written out",
    "torch.autograd.graph.Node.__subclasshook__": "the name of a class, in a module of C functions",
    "torch.nn.modules.transformer.TransformerEncoderLayer.forward": "`self.modules()`, of nn.Module",
}


@pytest.mark.slow
def test_every_place_that_looks_names_up_is_guarded_or_harmless() -> None:
    """A new release of torch or Python may bring new ones; whoever updates it looks at each."""
    found = find_doors()
    assert "torch.nn.modules.container.ParameterDict.__getitem__" in found
    guarded = {*guards.LIBRARIES}
    unknown = [
        name
        for name in found
        if not any(name.startswith(f"{module}.") for module in (*guarded, *CLOSED)) and name not in HARMLESS
    ]
    assert unknown == []
    for name in guarded:
        for function in ("getattr", "setattr", "delattr", "hasattr"):
            assert vars(sys.modules[name])[function].__module__ == guards.__name__


def test_leaves_are_found_in_a_deep_graph() -> None:
    """The graph is walked without recursion, each node once, however often paths join."""
    weight = torch.nn.Parameter(torch.ones(1))
    value = weight * 1
    for _ in range(3_000):
        value = value + value
    check_leaves(value, [weight])


def test_reasons_are_those_that_a_report_counts() -> None:
    """Every lie has a reason that summary and report count as misreporting, or one that the policy had before."""
    reasons = {lie.policy for lie in LIES.values()} | {lie.probe for lie in LIES.values()}
    assert set(MISREPORTING) == reasons - {None, *OTHERS}
