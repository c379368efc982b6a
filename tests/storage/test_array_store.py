"""Promise: an array comes back bit for bit under the digest of its bytes, and no other comes in its place."""

import base64
import hashlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

from tacevo.errors import CacheMissError, StoreError
from tacevo.records import Mode
from tacevo.storage.array_store import KIND, ArrayStore, digest_of
from tacevo.storage.listing import take_in, verify
from tacevo.storage.store import Store

#: With a zero of each sign, a denormal and the largest number.
ARRAY = np.array([[0.0, -0.0, 1e-45], [3.4028235e38, -1.5, 0.1]], dtype=np.float32)


def store(root: Path, mode: Mode = Mode.record) -> ArrayStore:
    """Return an array store."""
    return ArrayStore(Store(root, KIND, mode))


def exchange(root: Path, data: bytes) -> None:
    """Put other bytes under the question of the only array, with a checksum that fits."""
    (entry,) = Store(root, KIND).entries()
    Store(root, KIND).write(entry.request, {"base64": base64.b64encode(data).decode()})


@pytest.mark.parametrize("array", [ARRAY, np.array([3, 0, -1]), np.zeros((0, 3), np.float32)])
def test_array_comes_back_bit_for_bit(array: np.ndarray, tmp_path: Path) -> None:
    """Kept twice it is one entry, and a replay reads it."""
    digest = store(tmp_path).keep(array)
    assert digest == digest_of(array) == store(tmp_path).keep(array.copy())
    array_read = store(tmp_path, Mode.replay).read(digest, "<f4" if array.dtype == np.float32 else "<i8", array.shape)
    assert (array_read.tobytes(), array_read.dtype, array_read.shape) == (array.tobytes(), array.dtype, array.shape)
    assert len(list(Store(tmp_path, KIND).entries())) == 1


def test_digest_is_that_of_the_little_endian_bytes() -> None:
    """Whatever the order of bytes or of memory that an array has here."""
    assert digest_of(ARRAY) == digest_of(np.asfortranarray(ARRAY))
    assert digest_of(np.array([1, 2])) == hashlib.sha256(struct.pack("<2q", 1, 2)).hexdigest()


def test_array_of_another_shape_or_digest_is_missing(tmp_path: Path) -> None:
    """Both belong to the question."""
    digest = store(tmp_path).keep(ARRAY)
    for asked, shape in ((digest, (3, 2)), ("0" * 64, (2, 3))):
        with refused(CacheMissError, place="arrays ", expected="an array of shape"):
            store(tmp_path).read(asked, "<f4", shape)


@pytest.mark.parametrize("data", [ARRAY.tobytes()[:-4], ARRAY.tobytes() + b"\0", (ARRAY + 1).tobytes(), b""])
def test_other_bytes_are_refused_wherever_they_are_read(data: bytes, tmp_path: Path) -> None:
    """However well the entry is sealed: by a reader, by `cache verify` and by `cache import`."""
    digest = store(tmp_path / "a").keep(ARRAY)
    exchange(tmp_path / "a", data)
    with refused(StoreError, got="bytes of the digest ", expected="of shape (2, 3)"):
        store(tmp_path / "a").read(digest, "<f4", (2, 3))
    problems, files = verify(tmp_path / "a")
    assert (len(problems), files) == (1, 1)
    with refused(StoreError, got="bytes of the digest "):
        take_in(tmp_path, list(Store(tmp_path / "a", KIND).entries()), tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    """Their digest may be right: no training predicts them."""
    spoilt = np.array([1.0, np.nan], np.float32)
    digest = store(tmp_path).keep(spoilt)
    with refused(StoreError, expected="finite numbers"):
        store(tmp_path).read(digest, "<f4", (2,))


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ({"sha256": "0" * 64, "dtype": "<f4", "shape": [10**30]}, {"base64": ""}),
        ({"sha256": hashlib.sha256(b"").hexdigest(), "dtype": "<f4", "shape": [10**30, 0]}, {"base64": ""}),
        ({"sha256": hashlib.sha256(b"").hexdigest(), "dtype": "<f4", "shape": [0] * 99}, {"base64": ""}),
        ({"sha256": "0" * 64, "dtype": "|O", "shape": [1]}, {"base64": ""}),
        ({"sha256": "0" * 64, "dtype": "<f4", "shape": [1]}, {"base64": "not base64"}),
        ({"sha256": "0" * 64, "dtype": "<f4", "shape": [1]}, {"base64": 5}),
        ("an array", None),
    ],
)
def test_entry_of_no_known_form_is_a_problem(request_: Any, answer: Any, tmp_path: Path) -> None:
    """And never a traceback, since anybody may have written it."""
    Store(tmp_path, KIND).write(request_, answer)
    assert len(verify(tmp_path)[0]) == 1


def test_array_of_another_type_is_not_kept(tmp_path: Path) -> None:
    """Objects least of all."""
    with pytest.raises(ValueError, match="float32 or int64"):
        store(tmp_path).keep(np.array([1.0]))
