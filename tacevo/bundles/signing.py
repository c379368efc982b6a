"""The signature of a published file, which lies beside it as FILE.sig: in the file it would change what it signs."""

from pathlib import Path

from tacevo.errors import BundleError, ConfigError
from tacevo.storage.files import write_durably
from tacevo.storage.signatures import LONGEST, check, sign


def sign_bundle(target: Path, digest: str, key: Path | None) -> None:
    """Sign the bundle digest of a file, or remove the signature of the file that it replaced.

    Raises:
        ConfigError: as `tacevo.storage.signatures.sign`.
    """
    place = signature_of(target)
    if key is None:
        place.unlink(missing_ok=True)
    else:
        write_durably(place, sign(_signed(digest), key))


def describe_signature(target: Path, digest: str, allowed: Path | None) -> str:
    """Say in a line who signed a published file.

    Args:
        target: the file.
        digest: its bundle digest.
        allowed: a file of allowed signers; the file must then be signed by one of them.

    Raises:
        BundleError: what lies beside it is no signature of it; or it is not signed by an allowed signer.
        ConfigError: as `tacevo.storage.signatures.check`.
    """
    place = signature_of(target)
    if not place.is_file():
        if allowed is not None:
            raise BundleError("none", place=str(place), expected=f"a signature by one of {allowed}")
        return f"unsigned: no {place.name} lies beside it"
    text = place.read_bytes()[: LONGEST + 1].decode(errors="replace")
    try:
        signed = check(_signed(digest), text, allowed)
    except ConfigError as error:
        if allowed is not None:
            raise
        return f"signature not checked: {error}"
    if signed is None:
        raise BundleError("another text", place=str(place), expected=f"a signature of the bundle digest {digest}")
    if allowed is not None and signed.signer is None:
        raise BundleError(signed.key, place=str(place), expected=f"a signature by one of {allowed}")
    return f"signed by {signed.described}"


def signature_of(target: Path) -> Path:
    """Return where the signature of a published file lies."""
    return target.with_name(f"{target.name}.sig")


def _signed(digest: str) -> str:
    """Return the text that is signed: the digest and a line break."""
    return f"{digest}\n"
