"""What a research archive such as Zenodo wants of a published file, laid out in a directory of its own.

The archive gives a DOI after the file is written and its digests are known, so the DOI is a note beside the file.
"""

import hashlib
import json
import re
import zipfile
from pathlib import Path
from typing import Any

from tacevo.bundles.signing import signature_of
from tacevo.errors import BundleError, ConfigError
from tacevo.storage.files import write_durably

#: The members of a bundle that a reader of the archive wants to see without unpacking it.
PAPERS = ("README.md", "LICENSE.txt", "CITATION.cff")

#: The file by which an archive takes over the metadata, and by which a directory is known as a deposit.
METADATA = ".zenodo.json"

_SUMS = "SHA256SUMS"

#: The paper of the method, and how the deposit relates to it.
_PAPER = {"identifier": "arXiv:2606.30109", "relation": "isDerivedFrom", "scheme": "arxiv"}

_DOI = re.compile(r"10\.\d{4,9}/\S{1,200}")


def check_deposit(directory: Path, authors: tuple[str, ...]) -> None:
    """Check what a deposit needs, before the work.

    Raises:
        ConfigError: there is no author, whom every archive asks for; or something else lies in the directory.
    """
    if not authors:
        raise ConfigError("none", place="--author", expected="an author, whom every archive asks for")
    if directory.exists() and not (directory.is_dir() and (_is_deposit(directory) or not any(directory.iterdir()))):
        expected = "an empty directory, a new one, or an earlier deposit, which is replaced"
        raise ConfigError(str(directory), place="--deposit", expected=expected)


def deposit(bundle: Path, directory: Path) -> list[str]:
    """Lay out a bundle, its papers, checksums and metadata in a directory; return the names of the files.

    Args:
        bundle: a file that `tacevo publish` wrote; a signature beside it goes with it.
        directory: made if it is absent; the files of an earlier deposit are replaced.

    Raises:
        BundleError: the file is no bundle that was published with an author.
        StoreError: a file cannot be written.
    """
    files = {bundle.name: bundle.read_bytes()}
    if (signature := signature_of(bundle)).is_file():
        files[signature.name] = signature.read_bytes()
    with zipfile.ZipFile(bundle) as opened:
        files |= {name: opened.read(name) for name in PAPERS}
        crate = json.loads(opened.read("ro-crate-metadata.json"))
    files[METADATA] = (json.dumps(_metadata(crate, bundle), indent=2, ensure_ascii=False) + "\n").encode()
    sums = "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items()))
    directory.mkdir(parents=True, exist_ok=True)
    if _is_deposit(directory):  # what the user laid beside its files stays
        earlier = re.findall(
            r"^[0-9a-f]{64}  ([^/\n]+)$", (directory / _SUMS).read_text(errors="replace"), re.MULTILINE
        )
        for name in set(earlier) - files.keys():
            (directory / name).unlink(missing_ok=True)
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
    return None if found is None else found[0]


def _metadata(crate: Any, bundle: Path) -> dict[str, object]:
    """Write the metadata of a bundle's RO-Crate in the words of Zenodo."""
    entities = {str(entity["@id"]): entity for entity in crate["@graph"]}
    root = entities["./"]
    authors = [entities[each["@id"]]["name"] for each in _listed(root.get("author", []))]
    if not authors:
        raise BundleError("none", place=str(bundle), expected="a bundle that was published with an author")
    return {
        "upload_type": "dataset",
        "title": root["name"],
        "description": root["description"],
        "creators": [{"name": name} for name in authors],
        "publication_date": root["datePublished"],
        "license": str(root["license"]["@id"]).rsplit("/", 1)[-1].lower(),
        "version": root["identifier"],
        "keywords": ["neural architecture search", "quality-diversity", "tactile sensing", "reproducibility", "TacEvo"],
        "related_identifiers": [_PAPER],
    }


def _listed(value: Any) -> list[Any]:
    """RO-Crate writes one value without a list."""
    return value if isinstance(value, list) else [value]


def _is_deposit(directory: Path) -> bool:
    return (directory / METADATA).is_file() and (directory / _SUMS).is_file()
