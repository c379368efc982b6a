"""Keeps the password of a tracking URI out of what a process writes, whoever in the process writes it."""

import io
from typing import TextIO
from urllib.parse import unquote

#: URIs of these schemes that name no host have no place for a password.
_PATH_SCHEMES = frozenset({"sqlite", "file"})


class Veil(io.TextIOBase):
    """A stream that passes text on with the secrets of one URI replaced.

    Hidden are the URI as a whole (as `without_password` does), its user info and its password, each also with its
    escapes resolved. What it does not do: find a secret that is written in two halves, or escaped in other ways.

    Args:
        stream: where the text goes.
        uri: the URI.
    """

    def __init__(self, stream: TextIO, uri: str) -> None:
        self._stream = stream
        self._replacements = _replacements(uri)

    def write(self, text: str) -> int:
        """Pass a text on; return its length."""
        self._stream.write(_replaced(text, self._replacements))
        return len(text)

    def flush(self) -> None:
        """Pass on what is held back."""
        self._stream.flush()


def veiled(text: str, uri: str) -> str:
    """Replace the secrets of a URI in a text, as `Veil` does."""
    return _replaced(text, _replacements(uri))


def _replaced(text: str, replacements: list[tuple[str, str]]) -> str:
    for secret, shown in replacements:
        text = text.replace(secret, shown)
    return text


def _replacements(uri: str) -> list[tuple[str, str]]:
    """Pair each secret text of a URI with what to write in its place, the longest first."""
    shown = without_password(uri)
    if shown == uri:
        return []
    rest = uri.partition("://")[2]
    user_info, _, place = rest.rpartition("@")
    secrets = {user_info, user_info.partition(":")[2], place.partition("?")[2]} - {""}
    pairs = {text: "***" for secret in secrets for text in (secret, unquote(secret))}
    pairs |= {uri: shown, unquote(uri): shown}
    return sorted(pairs.items(), key=lambda pair: len(pair[0]), reverse=True)


def without_secrets(text: str, secrets: tuple[str, ...]) -> str:
    """Black out what must be seen nowhere."""
    for secret in secrets:
        text = text.replace(secret, "***")
    return text


def without_password(uri: str) -> str:
    """Hide what may be secret in a URI: `postgresql://user:pw@host/db` becomes `postgresql://***@host/db`.

    The user info reaches to the last `@`, because passwords are often written without the escapes that they need;
    a query, which may hold a password as well, becomes `?***`. A SQLite or file URI that names nothing but a path
    is unchanged, and so is text without `://`.
    """
    scheme, mark, rest = uri.partition("://")
    if not mark or (scheme in _PATH_SCHEMES and rest.startswith("/")):
        return uri
    _, at, place = rest.rpartition("@")
    place, question, _ = place.partition("?")
    return f"{scheme}://{'***@' if at else ''}{place}{'?***' if question else ''}"
