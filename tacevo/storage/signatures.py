"""Signatures of OpenSSH: who vouches for a published file or for a plan.

They are made and checked by the program ssh-keygen, so anybody can check one without this package:

    ssh-keygen -Y verify -f ALLOWED_SIGNERS -I NAME -n tacevo -s FILE.sig < TEXT
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.errors import ConfigError, TacevoError
from tacevo.text import printable

#: What the signatures are for; one that was made for another use is none.
NAMESPACE = "tacevo"

#: Bytes of a signature at most; those of RSA have some 3,000.
LONGEST = 20_000

_PROGRAM = "ssh-keygen"

#: What the program says of a signature that does not fit; all else that it says is about itself or this machine.
_UNFIT = "Could not verify signature"


@dataclass(frozen=True, slots=True)
class Signed:
    """A signature that fits its text."""

    #: The kind of key and its fingerprint, as `ED25519 key SHA256:...`.
    key: str
    #: The name that the file of allowed signers gives the key; None where it names none, or no such file was given.
    signer: str | None

    @property
    def described(self) -> str:
        """Who signed, in words."""
        return f"{self.signer} ({self.key})" if self.signer else f"{self.key}, whose owner is not known here"


def checked_key(key: Path) -> Path:
    """Return the file of a key, before the work that shall be signed.

    Raises:
        ConfigError: it is no file of a key, or OpenSSH is not installed.
    """
    expected, remedy = "the file of an SSH key", "ssh-keygen makes one"
    if not key.is_file():
        raise ConfigError(str(key), place="--sign", expected=expected, remedy=remedy)
    done = _run(["-l", "-f", str(key)], "")
    if done.returncode:
        raise ConfigError(f"{key}: {_said(done)}", place="--sign", expected=expected, remedy=remedy)
    return key


def sign(text: str, key: Path) -> str:
    """Sign a text with a key that `checked_key` returned: the private one of its file, or of an agent for a public one.

    Raises:
        ConfigError: the key cannot sign, or OpenSSH is not installed.
    """
    done = _run(["-Y", "sign", "-f", str(key), "-n", NAMESPACE], text)
    if done.returncode:
        raise ConfigError(f"{key}: {_said(done)}", place="--sign", expected="a key that can sign")
    return done.stdout.decode()


def describe(
    text: str, signature: bytes, allowed: Path | None, *, place: str, expected: str, error: type[TacevoError]
) -> str:
    """Say in a line who signed a text, or that this machine cannot check it.

    Args:
        text: as of `check`.
        signature: as of `check`.
        allowed: as of `check`; the text must then be signed by one of them.
        place: where the signature stands, for errors.
        expected: what should stand there, for errors.
        error: the class of the error.

    Raises:
        TacevoError: of the class `error`: it is no signature of the text, or not one by an allowed signer.
        ConfigError: as `check`, where there are allowed signers.
    """
    try:
        signed = check(text, signature, allowed)
    except ConfigError as problem:
        if allowed is not None:
            raise
        return f"signature not checked: {problem}"
    if signed is None:
        raise error("a signature of another text", place=place, expected=expected)
    if allowed is not None and signed.signer is None:
        raise error(signed.key, place=place, expected=f"a signature by one of {allowed}")
    return f"signed by {signed.described}"


def check(text: str, signature: bytes, allowed: Path | None) -> Signed | None:
    """Check a signature of a text; None where it is no signature of it.

    Args:
        text: what was signed.
        signature: what `sign` returned, or whatever lies in its place.
        allowed: a file of allowed signers: on each line a name (or several, with commas), and a public key, as `man
            ssh-keygen` describes it. Names with `*`, `?` or `!` are patterns, and name nobody.

    Raises:
        ConfigError: this machine's OpenSSH is missing, too old or fails; or there is no such file.
    """
    if allowed is not None and not allowed.is_file():
        expected = "a file with a name and a public key on each line"
        raise ConfigError(str(allowed), place="--allowed-signers", expected=expected)
    if len(signature) > LONGEST:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "signature"
        file.write_bytes(signature)
        done = _run(["-Y", "check-novalidate", "-n", NAMESPACE, "-s", str(file)], text)
        said = done.stdout.decode(errors="replace")
        found = re.search(rf'^Good "{NAMESPACE}" signature with (\S+ key SHA256:\S+)', said, re.MULTILINE)
        if not done.returncode and found is not None:
            return Signed(found[1], None if allowed is None else _signer(text, file, allowed))
    if _UNFIT in said:
        return None
    raise ConfigError(
        _said(done), place=_PROGRAM, expected="an answer about the signature", remedy="it takes OpenSSH 8.2 or later"
    )


def _signer(text: str, signature: Path, allowed: Path) -> str | None:
    """Return the first name of a file under which the key of a signature may sign now."""
    for name in dict.fromkeys(_names(allowed)):
        verify = ["-Y", "verify", "-f", str(allowed), "-I", name, "-n", NAMESPACE, "-s", str(signature)]
        if not _run(verify, text).returncode:
            return printable(name)
    return None


def _names(allowed: Path) -> Iterator[str]:
    for number, line in enumerate(allowed.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        first = line.split(maxsplit=1)[0] if line.strip() and not line.lstrip().startswith("#") else ""
        if re.match(r"(ssh|ecdsa|sk-ssh|sk-ecdsa)-", first):
            got, remedy = "a key without one", f"write a name and a space before it: ada@lab {first} ..."
            raise ConfigError(got, place=f"{allowed}, line {number}", expected="a name and its key", remedy=remedy)
        yield from (name for name in first.split(",") if name and not re.search(r"[*?!]", name))


def _said(done: subprocess.CompletedProcess[bytes]) -> str:
    lines = (done.stderr + done.stdout).decode(errors="replace").strip().splitlines()
    return printable(lines[-1]) if lines else "nothing"


def _run(arguments: Sequence[str], text: str) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(
            [_PROGRAM, *arguments],
            input=text.encode(),
            check=False,
            capture_output=True,
            env={**os.environ, "LC_ALL": "C"},
        )
    except OSError as error:
        raise ConfigError(
            f"none ({error.strerror})",
            place="signatures",
            expected=f"the program {_PROGRAM} of OpenSSH 8.2 or later",
            remedy="install OpenSSH",
        ) from error
