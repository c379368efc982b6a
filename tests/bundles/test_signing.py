"""Promise: who signed a published file or a plan is told by each replay, and no signature of another text passes."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from commands import publish

from tacevo.bundles.open import opened
from tacevo.bundles.signing import signature_of_digest, signature_place
from tacevo.cli.app import main

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="no OpenSSH here"),
]

#: A file of names and public keys.
SIGNERS = "signers"


@pytest.fixture
def key(place: Path) -> Path:
    """Return the file of a new key, which `SIGNERS` calls ada@lab."""
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "key"], cwd=place, check=True)
    (place / SIGNERS).write_text(f"ada@lab {(place / 'key.pub').read_text()}")
    return place / "key"


@pytest.fixture
def bundle(published: Path, place: Path) -> Path:
    """Return a published run where the test works."""
    return Path(shutil.copy(published / "run.zip", place / "run.zip"))


def sign_bundle(bundle: Path, digest: str, key: Path) -> None:
    """Lay a signature of a digest beside a bundle."""
    signature_place(bundle).write_text(signature_of_digest(digest, key))


def digest_of(bundle: Path) -> str:
    """Return the bundle digest of a file."""
    digest = opened(bundle).digest
    assert digest is not None
    return digest


def test_replay_names_who_signed(bundle: Path, key: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By the key alone, and by name where the reader says whose keys count."""
    assert main(["replay", "run.zip"]) == 0
    assert "\nunsigned: " in capsys.readouterr().out
    sign_bundle(bundle, digest_of(bundle), key)
    assert main(["replay", "run.zip"]) == 0
    assert "\nsigned by ED25519 key SHA256:" in capsys.readouterr().out
    assert main(["replay", "run.zip", "--allowed-signers", SIGNERS]) == 0
    assert "\nsigned by ada@lab (ED25519 key SHA256:" in capsys.readouterr().out


def test_signature_can_be_checked_without_this_package(bundle: Path, key: Path) -> None:
    """By the line that the page of publishing gives."""
    sign_bundle(bundle, digest_of(bundle), key)
    verify = ["ssh-keygen", "-Y", "verify", "-f", SIGNERS, "-I", "ada@lab", "-n", "tacevo", "-s", "run.zip.sig"]
    subprocess.run(verify, input=f"{digest_of(bundle)}\n", text=True, check=True)


@pytest.mark.parametrize("fault", ["other", "garbage", "long", "empty"])
def test_signature_of_another_text_is_refused(
    fault: str, bundle: Path, key: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever lays something beside a bundle that looks like its signature is found out, with or without signers."""
    sign_bundle(bundle, "0" * 64, key)
    signature = bundle.with_name("run.zip.sig")
    others = {"garbage": b"\xff\x00", "long": b"-" * 10**6, "empty": b""}
    signature.write_bytes(others.get(fault, signature.read_bytes()))
    for options in ([], ["--allowed-signers", SIGNERS]):
        assert main(["replay", "run.zip", *options]) == 1
        assert "run.zip.sig: expected a signature of the bundle digest" in capsys.readouterr().err


def test_who_asks_for_signers_accepts_no_other(bundle: Path, key: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither an unsigned bundle, nor one by a key that has no name there."""
    assert main(["replay", "run.zip", "--allowed-signers", SIGNERS]) == 1
    assert "expected a signature by one of signers; got none" in capsys.readouterr().err
    sign_bundle(bundle, digest_of(bundle), key)
    Path("others").write_text(f"eve@lab {Path('key.pub').read_text()[:-20]}\n")
    assert main(["replay", "run.zip", "--allowed-signers", "others"]) == 1
    assert "expected a signature by one of others; got ED25519 key SHA256:" in capsys.readouterr().err
    assert main(["replay", "run.zip", "--allowed-signers", "missing"]) == 2
    capsys.readouterr()
    assert main(["replay", "run.zip", "--allowed-signers", "key.pub"]) == 2
    assert "key.pub, line 1: expected a name and its key" in capsys.readouterr().err


def test_published_file_has_no_byte_of_the_key(folder: Path, key: Path) -> None:
    """Signing changes nothing in the bundle; its signature stays until another bundle takes the place."""
    publish("run", "-o", "signed.zip", "--author", "A. Nyone", "--sign", "key")
    publish("run", "-o", "plain.zip", "--author", "A. Nyone")
    assert Path("signed.zip").read_bytes() == Path("plain.zip").read_bytes()
    assert Path("signed.zip.sig").read_text().startswith("-----BEGIN SSH SIGNATURE-----")
    publish("run", "-o", "signed.zip", "--author", "A. Nyone")
    assert Path("signed.zip.sig").exists()
    publish("run", "-o", "signed.zip", "--author", "Another")
    assert not Path("signed.zip.sig").exists()


@pytest.mark.parametrize("name", ["nowhere", "garbage"])
def test_unusable_key_is_told_before_the_work(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is replayed or written for it."""
    Path("garbage").write_text("no key")
    assert main(["publish", "run", "-o", "run.zip", "--sign", name]) == 2
    assert "error: --sign: expected the file of an SSH key; got " in capsys.readouterr().err
    assert not Path("run.zip").exists()


@pytest.mark.parametrize("program", ["", "#!/bin/sh\necho 'unknown option -- Y' >&2; exit 1\n"])
def test_machine_that_cannot_check_says_so(
    program: str, bundle: Path, key: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No OpenSSH, or an old one: a replay that asks for no signer goes on, and calls it neither signed nor forged."""
    sign_bundle(bundle, digest_of(bundle), key)
    Path("bin").mkdir()
    if program:
        Path("bin/ssh-keygen").write_text(program)
        Path("bin/ssh-keygen").chmod(0o755)
    monkeypatch.setenv("PATH", str(Path("bin").resolve()))
    assert main(["replay", "run.zip"]) == 0
    said = capsys.readouterr().out
    assert "\nsignature not checked: " in said
    assert "signed by" not in said
    assert main(["replay", "run.zip", "--allowed-signers", SIGNERS]) == 2


def test_signer_is_one_whom_the_file_names(bundle: Path, key: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Under whichever of its lines the key may sign; a pattern is nobody's name, and a byte that is no text is none."""
    sign_bundle(bundle, digest_of(bundle), key)
    public = Path("key.pub").read_text().strip()
    Path("many").write_bytes(
        f'# a\xe9\ngit@lab namespaces="git" {public}\n!eve@home,*@home {public}\n'.encode("latin-1")
    )
    assert main(["replay", "run.zip", "--allowed-signers", "many"]) == 1
    with Path("many").open("a") as file:
        file.write(f"ada@lab,ada@home {public}\n")
    capsys.readouterr()
    assert main(["replay", "run.zip", "--allowed-signers", "many"]) == 0
    assert "\nsigned by ada@lab (" in capsys.readouterr().out


@pytest.mark.room("plans, pilots")
def test_signed_plan_stays_signed_in_what_follows_it(
    folder: Path, key: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It travels in the study's record, and a replay names its signer; an edited one is refused."""
    wish = ["plan", "study", "run", "--effect", "0.5", "--comparisons", "1"]
    assert main([*wish, "--sign", "key"]) == 0
    assert "; signed by ED25519 key SHA256:" in capsys.readouterr().out
    plan = Path("build/plan/plan.json")
    assert main(["study", "run=run", "elites=1", "seeds=4", "epochs=1", f"plan={plan}"]) == 0
    publish("run", "-o", "run.zip")
    sign_bundle(Path("run.zip"), digest_of(Path("run.zip")), key)
    capsys.readouterr()
    assert main(["replay", "run.zip", "--allowed-signers", SIGNERS]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("plan of study")]
    assert ["; signed by ada@lab (ED25519" in line for line in lines].count(True) == 1
    assert [line.endswith(": none") for line in lines].count(True) == len(lines) - 1
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "other"], check=True)
    Path("others").write_text(f"eve@lab {Path('other.pub').read_text()}")
    sign_bundle(Path("run.zip"), digest_of(Path("run.zip")), Path("other"))
    assert main(["replay", "run.zip", "--allowed-signers", "others"]) == 1
    assert "plan: expected a signature by one of others" in capsys.readouterr().err
    plan.write_text(json.dumps(json.loads(plan.read_text()) | {"seeds": 99}))
    assert main(["study", "run=run", "elites=1", "seeds=2", "epochs=1", f"plan={plan}"]) == 2
    assert "plan: expected a plan as it was signed; got a signature of another text" in capsys.readouterr().err
