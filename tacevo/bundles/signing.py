"""The signature of a published file, which lies beside it as FILE.sig: in the file it would change what it signs."""

from pathlib import Path

from tacevo.errors import BundleError
from tacevo.storage.signatures import LONGEST, describe, sign


def signature_of_digest(digest: str, key: Path) -> str:
    """Sign a bundle digest with the key of a file.

    Raises:
        ConfigError: as `tacevo.storage.signatures.sign`.
    """
    return sign(_signed(digest), key)


def describe_signature(bundle: Path, digest: str, allowed: Path | None) -> str:
    """Say in a line who signed a published file.

    Args:
        bundle: the file.
        digest: its bundle digest.
        allowed: a file of allowed signers; the file must then be signed by one of them.

    Raises:
        BundleError: what lies beside it is no signature of it; or it is not signed by an allowed signer.
        ConfigError: as `tacevo.storage.signatures.describe`.
    """
    place = signature_place(bundle)
    if not place.is_file():
        if allowed is not None:
            raise BundleError("none", place=str(place), expected=f"a signature by one of {allowed}")
        return f"unsigned: no {place.name} lies beside it"
    with place.open("rb") as file:
        signature = file.read(LONGEST + 1)
    expected = f"a signature of the bundle digest {digest}"
    return describe(_signed(digest), signature, allowed, place=str(place), expected=expected, error=BundleError)


def signature_place(bundle: Path) -> Path:
    """Return where the signature of a published file lies."""
    return bundle.with_name(f"{bundle.name}.sig")


def _signed(digest: str) -> str:
    """Return the text that is signed: the digest and a line break."""
    return f"{digest}\n"
