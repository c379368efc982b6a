"""The parts of models that the test server can take: what they refuse, how they think, what the Models API says."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

#: The efforts of the Messages API, and its kinds of thinking.
EFFORTS = ("low", "medium", "high", "xhigh", "max")
THINKINGS = ("adaptive", "disabled", "enabled")

#: Tokens that a model thinks before an answer.
THOUGHT_TOKENS = 30

#: The settings by which older models draw tokens.
_SAMPLING = ("temperature", "top_p", "top_k")


@dataclass(frozen=True, kw_only=True)
class Model:
    """What a model takes, and whether it thinks where it is not asked."""

    samples: bool
    efforts: tuple[str, ...]
    thinkings: tuple[str, ...]
    thinks_unasked: bool
    retires_at: str | None = None

    def refusal(self, body: Mapping[str, Any]) -> str:
        """Say which setting of a body is refused, in the words of the real API; empty where none."""
        for name in _SAMPLING:
            if name in body and not self.samples:
                return f"`{name}` is deprecated for this model."
        effort = body.get("output_config", {}).get("effort")
        if effort is not None and not self.efforts:
            return "This model does not support the effort parameter."
        if effort is not None and effort not in self.efforts:
            return f"output_config.effort: '{effort}' is not supported for this model."
        kind = body.get("thinking", {}).get("type")
        if kind is not None and kind not in self.thinkings:
            other = ' Use "thinking.type.adaptive" and "output_config.effort" to control thinking behavior.'
            return f'"thinking.type.{kind}" is not supported for this model.{other if self.efforts else ""}'
        if kind in {"adaptive", "enabled"} and body.get("temperature", 1) != 1:
            return "`temperature` may only be set to 1 when thinking is enabled or in adaptive mode."
        return ""

    def thinks(self, body: Mapping[str, Any]) -> bool:
        """Say whether the model thinks before it answers a body."""
        kind = body.get("thinking", {}).get("type")
        return self.thinks_unasked if kind is None else kind != "disabled"

    def told(self, name: str) -> dict[str, Any]:
        """Write what the Models API says of the model."""
        efforts = {each: {"supported": each in self.efforts} for each in EFFORTS}
        types = {each: {"supported": each in self.thinkings} for each in THINKINGS}
        return {
            "id": name,
            "type": "model",
            "display_name": name,
            "created_at": "2026-01-01T00:00:00Z",
            "lifecycle": "active" if self.retires_at is None else "deprecated",
            "retires_at": self.retires_at,
            "max_input_tokens": 200_000,
            "max_tokens": 64_000,
            "capabilities": {
                "batch": {"supported": True},
                "effort": {"supported": bool(self.efforts), **efforts},
                "thinking": {"supported": self.thinkings != ("disabled",), "types": types},
            },
        }


_CURRENT = Model(samples=False, efforts=EFFORTS, thinkings=("adaptive", "disabled"), thinks_unasked=True)
_ALWAYS_THINKING = Model(samples=False, efforts=EFFORTS, thinkings=("adaptive",), thinks_unasked=True)

#: The models, by name, as their documentation describes them.
MODELS: Mapping[str, Model] = {
    "claude-haiku-4-5": Model(samples=True, efforts=(), thinkings=("disabled", "enabled"), thinks_unasked=False),
    "claude-haiku-5-5": _CURRENT,
    "claude-sonnet-5-5": _CURRENT,
    "claude-opus-5-5": _ALWAYS_THINKING,
    "claude-fable-5-1": _ALWAYS_THINKING,
}
