"""Signatures of OpenSSH: who vouches for a published file or for a plan.

They are made and checked by the program ssh-keygen, so anybody can check one without this package:

    ssh-keygen -Y verify -f ALLOWED_SIGNERS -I NAME -n tacevo -s FILE.sig < TEXT
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.errors import ConfigError
from tacevo.text import printable

#: What the signatures are for; one that was made for another use is none.
NAMESPACE = "tacevo"

#: Bytes of a signature at most; those of RSA have some 3,000.
LONGEST = 20_000

_PROGRAM = "ssh-keygen"


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
        ConfigError: there is none, or OpenSSH is not installed.
    """
    if not key.is_file():
        raise ConfigError(str(key), place="--sign", expected="the file of an SSH key", remedy="ssh-keygen makes one")
    _run(["-l", "-f", str(key)], "")
    return key


def sign(text: str, key: Path) -> str:
    """Sign a text with the private key of a file, or with that of an agent where the file is a public key.

    Raises:
        ConfigError: as `checked_key`, or the key cannot sign.
    """
    done = _run(["-Y", "sign", "-f", str(checked_key(key)), "-n", NAMESPACE], text)
    if done.returncode:
        said = printable((done.stderr.strip().splitlines() or ["nothing"])[-1])
        raise ConfigError(f"{key}, of which {_PROGRAM} said: {said}", place="--sign", expected="a key that can sign")
    return done.stdout


def check(text: str, signature: str, allowed: Path | None) -> Signed | None:
    """Check a signature of a text; None where it is no signature of it.

    Args:
        text: what was signed.
        signature: what `sign` returned.
        allowed: a file of allowed signers, as `man ssh-keygen` describes it: a name and a public key on each line.

    Raises:
        ConfigError: OpenSSH is not installed, or there is no such file.
    """
    if allowed is not None and not allowed.is_file():
        expected = "a file with a name and a public key on each line"
        raise ConfigError(str(allowed), place="--allowed-signers", expected=expected)
    if len(signature) > LONGEST:
        return None
    with tempfile.NamedTemporaryFile("w", suffix=".sig") as file:
        file.write(signature)
        file.flush()
        done = _run(["-Y", "check-novalidate", "-n", NAMESPACE, "-s", file.name], text)
        found = re.search(rf'^Good "{NAMESPACE}" signature with (\S+ key SHA256:\S+)$', done.stdout, re.MULTILINE)
        if done.returncode or found is None:
            return None
        return Signed(found[1], None if allowed is None else _signer(text, file.name, str(allowed)))


def _signer(text: str, signature: str, allowed: str) -> str | None:
    """Return the name under which the key of a signature may sign now."""
    names = _run(["-Y", "find-principals", "-s", signature, "-f", allowed], "")
    for name in names.stdout.splitlines():
        verify = ["-Y", "verify", "-f", allowed, "-I", name, "-n", NAMESPACE, "-s", signature]
        if not _run(verify, text).returncode:
            return printable(name)
    return None


def _run(arguments: Sequence[str], text: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            [_PROGRAM, *arguments],
            input=text,
            check=False,
            capture_output=True,
            text=True,
            env={**os.environ, "LC_ALL": "C"},
        )
    except OSError as error:
        raise ConfigError(
            f"none ({error.strerror})",
            place="signatures",
            expected=f"the program {_PROGRAM} of OpenSSH 8.2 or later",
            remedy="install OpenSSH",
        ) from error
