"""What a research archive such as Zenodo wants of a published file, laid out in a directory of its own.

The archive gives a DOI after the file is written and its digests are known, so the DOI is a note beside the file.
"""

import hashlib
import html
import json
import re
import zipfile
from pathlib import Path
from typing import Any

from tacevo.bundles.signing import signature_place
from tacevo.errors import BundleError, ConfigError
from tacevo.storage.files import write_durably
from tacevo.text import printable

#: The members of a bundle that a reader of the archive wants to see without unpacking it.
PAPERS = ("README.md", "LICENSE.txt", "CITATION.cff")

#: The fields that Zenodo asks for, under its own names.
METADATA = ".zenodo.json"

_SUMS = "SHA256SUMS"

#: The paper of the method, and how the deposit relates to it.
_PAPER = {"identifier": "arXiv:2606.30109", "relation": "isDerivedFrom", "scheme": "arxiv"}

_DOI = re.compile(r"10\.\d{4,9}/\S{1,200}")


def check_deposit(bundle: Path, directory: Path, authors: tuple[str, ...]) -> None:
    """Check what a deposit needs, before the work, and make its directory.

    Raises:
        ConfigError: there is no author, whom every archive asks for; the directory is not empty, or cannot be made; or
            the bundle has the name of one of the other files.
    """
    if not authors:
        raise ConfigError("none", place="--author", expected="an author, whom every archive asks for")
    if bundle.name in {*PAPERS, METADATA, _SUMS}:
        raise ConfigError(bundle.name, place="--output", expected="another name: a file beside it is called so")
    expected = "a new or an empty directory"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        is_empty = not any(directory.iterdir())
    except OSError as error:
        got = f"{directory} ({error.strerror})"
        raise ConfigError(got, place="--deposit", expected=expected) from error
    if not is_empty:
        raise ConfigError(f"{directory}, which has files", place="--deposit", expected=expected)


def deposit(bundle: Path, directory: Path) -> list[str]:
    """Lay out a bundle, its papers, checksums and metadata in a directory; return the names of the files.

    Args:
        bundle: a file that `tacevo publish` wrote; a signature beside it goes with it.
        directory: as `check_deposit` left it.

    Raises:
        BundleError: the file is no bundle that was published with an author.
        StoreError: a file cannot be written.
    """
    files = {bundle.name: bundle.read_bytes()}
    if (signature := signature_place(bundle)).is_file():
        files[signature.name] = signature.read_bytes()
    try:
        with zipfile.ZipFile(bundle) as opened:
            files |= {name: opened.read(name) for name in PAPERS}
            metadata = _metadata(json.loads(opened.read("ro-crate-metadata.json")))
    except (zipfile.BadZipFile, KeyError, ValueError) as error:
        expected = "a bundle that was published with an author"
        raise BundleError(str(error), place=str(bundle), expected=expected) from error
    files[METADATA] = (json.dumps(metadata, indent=2, ensure_ascii=False) + "\n").encode()
    sums = "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items()))
    for name, data in {**files, _SUMS: sums.encode()}.items():
        write_durably(directory / name, data)
    return [*sorted(files), _SUMS]


def doi_of(bundle: Path) -> str | None:
    """Read the DOI that an archive gave a bundle from FILE.doi beside it; None where nothing like one stands there."""
    place = bundle.with_name(f"{bundle.name}.doi")
    if not place.is_file():
        return None
    with place.open(errors="replace") as file:
        found = _DOI.search(file.read(1000))
    return None if found is None else printable(found[0].rstrip(".,;)"))


def _metadata(crate: Any) -> dict[str, object]:
    """Write the metadata of a bundle's RO-Crate under the names of Zenodo.

    Raises:
        KeyError: it has no author, or is no RO-Crate of ours.
    """
    entities = {str(entity["@id"]): entity for entity in crate["@graph"]}
    root = entities["./"]
    authors = root["author"] if isinstance(root["author"], list) else [root["author"]]  # one value is in no list
    return {
        "upload_type": "dataset",
        "title": root["name"],
        "description": html.escape(root["description"], quote=False),  # which archives read as HTML
        "creators": [{"name": entities[each["@id"]]["name"]} for each in authors],
        "publication_date": root["datePublished"],
        "license": str(root["license"]["@id"]).rsplit("/", 1)[-1].lower(),
        "version": root["identifier"],
        "keywords": ["neural architecture search", "quality-diversity", "tactile sensing", "reproducibility", "TacEvo"],
        "related_identifiers": [_PAPER],
    }
