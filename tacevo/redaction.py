"""Keep passwords, keys and places of a machine out of what is recorded and shown."""

import re
from collections.abc import Mapping

from tacevo.errors import ConfigError

#: Addresses of these schemes are paths, which hold no password.
_PATH_SCHEMES = frozenset({"sqlite", "file"})

#: The parts by which a name in the query of an address is that of a password.
_SECRET_NAMES = ("passw", "pwd", "secret", "token")

#: The pattern for the name of an environment variable that holds a secret.
_SECRET_VARIABLE = re.compile(
    r"(^|_)((API)?KEYS?|(API)?TOKENS?|SECRETS?|CREDENTIALS?|PAT|PASS)(_|$)|_PWD$|PASSW|PASSPHRASE", re.IGNORECASE
)


#: Characters from which on a secret is taken out of messages, and of its beginning, where no more is there.
_SHORTEST, _BEGINNING = 8, 16


def is_secret_variable(name: str) -> bool:
    """Return whether a variable of the environment is, by its name, a password or a key."""
    return _SECRET_VARIABLE.search(name) is not None


def secret_variables(environment: Mapping[str, str]) -> tuple[str, ...]:
    """List the variables that hold a password or a key, by their names, or as an address with a password in it."""
    return tuple(
        sorted(name for name, value in environment.items() if is_secret_variable(name) or _holds_password(value))
    )


def check_address(address: str, place: str) -> None:
    """Raise ConfigError where a text is an address (`SCHEME://...`) with a password in it, which it does not show."""
    if _holds_password(address):
        expected = "an address without a password, because it is recorded"
        remedy = (
            "set the password in the environment (MLFLOW_TRACKING_PASSWORD, PGPASSWORD) or in a pass file, or the "
            "whole address in MLFLOW_TRACKING_URI, which is never recorded"
        )
        raise ConfigError("one with a password", place=place, expected=expected, remedy=remedy)


def _holds_password(address: str) -> bool:
    scheme, mark, rest = address.partition("://")
    if not mark or (scheme in _PATH_SCHEMES and rest.startswith("/")):
        return False
    user_info, _, host = rest.removeprefix("***@").rpartition("@")  # a password may itself hold an @
    is_token = bool(user_info) and scheme in {"http", "https"}
    query = host.partition("?")[2].lower()
    return ":" in user_info or is_token or any(name in query for name in _SECRET_NAMES)


def names_place(name: str) -> bool:
    """Return whether the name of a model tells of a machine: an absolute path, alone or behind a scheme, an address."""
    return re.search(r"(^|[:=\s/])[/\\~]|(^|[^A-Za-z])[A-Za-z]:[/\\]", name) is not None


def without_secrets(text: str, secrets: tuple[str, ...]) -> str:
    """Replace every secret of 8 or more characters in a message by `***`.

    It is found across blanks and line breaks, and where only its beginning is there: a message may be cut. Shorter ones
    stay, as they may be part of any word: servers that want no key are given `any` or `x`.
    """
    for secret in secrets:
        if len(secret) < _SHORTEST:
            continue
        begun = re.compile(r"\s*".join(map(re.escape, secret[:_BEGINNING])))
        kept, position = "", 0
        while (found := begun.search(text, position)) is not None:
            kept, position = f"{kept}{text[position : found.start()]}***", found.end()
            for letter in secret[_BEGINNING:]:
                after = len(text) - len(text[position:].lstrip())
                if text[after : after + 1] != letter:
                    break
                position = after + 1
        text = kept + text[position:]
    return text


def repeats_secret(text: str, secrets: tuple[str, ...]) -> bool:
    """Answer whether a text holds a secret that looks like a key, be it divided by signs, quotes or line breaks."""
    keys = [_letters(secret) for secret in secrets if looks_like_key(secret)]
    letters = _letters(text) if keys else ""
    return any(key in letters for key in keys)


def looks_like_key(secret: str) -> bool:
    """Answer whether a login is a key, and not a word in the place of one, such as `any` or `sk-no-key-required`.

    A key has at least 16 letters and digits, 6 of them different, of two kinds: digits, small letters, capitals.
    """
    letters = _letters(secret)
    kinds = sum(any(map(kind, letters)) for kind in (str.isdigit, str.islower, str.isupper))
    return len(letters) >= 16 and len(set(letters)) >= 6 and kinds >= 2


def _letters(text: str) -> str:
    return re.sub("[^A-Za-z0-9]", "", text)


def without_password(address: str) -> str:
    """Hide what may be secret in an address: `https://user:pw@host/v1` becomes `https://***@host/v1`.

    The user info reaches to the last `@`, because passwords are often written without the escapes that they need.
    A query becomes `?***`. A path, and text without `://`, stays as it is.
    """
    scheme, mark, rest = address.partition("://")
    if not mark or (scheme in _PATH_SCHEMES and rest.startswith("/")):
        return address
    _, at, host = rest.rpartition("@")
    host, question, _ = host.partition("?")
    return f"{scheme}://{'***@' if at else ''}{host}{'?***' if question else ''}"
