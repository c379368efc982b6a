"""A request to ask any model with."""

from tacevo.records import ChatMessage, Request, Setting

KEY = "sk-ant-a-secret-key-0123456789"


def request(text: str, *, settings: tuple[tuple[str, Setting], ...] = (), draw: int = 1) -> Request:
    """Make a request."""
    return Request(
        model="model-x",
        system="Be brief.",
        messages=(ChatMessage(role="user", content=text),),
        temperature=0.65,
        max_tokens=77,
        draw=draw,
        settings=settings,
    )
