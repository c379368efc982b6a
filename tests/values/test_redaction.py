"""No password is recorded: an address that holds one is rejected, and no part of it is shown."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.errors import ConfigError
from tacevo.redaction import check_address, names_place, secret_variables, without_password


@pytest.mark.parametrize(
    "address",
    [
        "postgresql://user:hunter2@host/db",
        "postgresql://user:hun@ter2/o?rd@host:5432/db",
        "https://hunter2@host/mlflow",
        "postgresql:///db?user=u&password=hunter2",
        "mssql+pyodbc:///?odbc_connect=UID%3Du%3BPWD%3Dhunter2",
        "sqlite+pysqlcipher://:hunter2@/file.db",
    ],
)
def test_address_with_a_password_is_rejected(address: str) -> None:
    """The error names the setting and the other ways, and shows nothing of the address."""
    with refused(ConfigError, place="tracking.uri", got="one with a password", remedy="MLFLOW_TRACKING_PASSWORD"):
        check_address(address, "tracking.uri")


@pytest.mark.parametrize(
    "address",
    [
        "http://localhost:5000",
        "postgresql://user@host:5432/db?sslmode=require",
        "sqlite:////home/me@work/mlflow.db?timeout=9",
        "file:///home/me@work/mlruns",
        "/home/me:you@work/mlruns",
        "",
        "https://***@host/mlflow",
    ],
)
def test_address_without_a_password_is_accepted(address: str) -> None:
    """A user's name, a path, and what an earlier version left of an address are not passwords."""
    check_address(address, "tracking.uri")


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("postgresql://user:p@w/o?rd@host:5432/db", "postgresql://***@host:5432/db"),
        ("https://token@host/v1", "https://***@host/v1"),
        ("https://host/v1?key=k", "https://host/v1?***"),
        ("sqlite:////home/me@work/mlflow.db?timeout=9", "sqlite:////home/me@work/mlflow.db?timeout=9"),
        ("", ""),
    ],
)
def test_password_of_an_address_is_hidden(address: str, shown: str) -> None:
    """User info and query are replaced; a plain path stays as it is."""
    assert without_password(address) == shown
    assert without_password(shown) == shown


@given(st.text(), st.text())
def test_no_part_of_the_user_info_is_shown(user_info: str, place: str) -> None:
    """Whatever stands before the last @ of an address makes no difference to what is shown of it."""
    assert without_password(f"postgresql://{user_info}@{place}") == without_password(f"postgresql://u@{place}")


def test_variables_with_a_secret_are_known_by_name_or_by_the_address_in_them() -> None:
    """Keys, tokens and passwords; what a job needs otherwise stays."""
    secrets = {
        "ANTHROPIC_API_KEY": "a",
        "ANTHROPIC_AUTH_TOKEN": "b",
        "OPENAI_API_KEY": "c",
        "AWS_SECRET_ACCESS_KEY": "d",
        "MLFLOW_TRACKING_PASSWORD": "e",
        "PGPASSWORD": "f",
        "MYSQL_PWD": "g",
        "GITHUB_PAT": "h",
        "TOKENS": "i",
        "APP_SECRETS": "j",
        "DATABASE_PASS": "k",
        "MLFLOW_TRACKING_URI": "postgresql://user:hunter2@host/db",
    }
    kept = {
        "PATH": "/bin",
        "PWD": "/home",
        "OLDPWD": "/",
        "TOKENIZERS_PARALLELISM": "false",
        "KEYBOARD": "us",
        "SSH_AUTH_SOCK": "/tmp/agent",
        "XDG_DATA_HOME": "/data",
        "HTTP_PROXY": "http://proxy:3128",
    }
    assert set(secret_variables({**secrets, **kept})) == set(secrets)


@pytest.mark.parametrize(
    ("name", "is_place"),
    [
        *(
            (name, True)
            for name in ("/models/m", "~/m", "file:///models/m", "local:/m", "openai//srv/m", "https://host/m")
        ),
        *((name, True) for name in ("C:\\models\\m", "c:/models/m", "\\\\host\\share\\m", "hf:D:/m")),
        *((name, False) for name in ("meta-llama/Llama-3.1-8B", "qwen2.5:7b", "accounts/fireworks/models/m", "@cf/m")),
        *((name, False) for name in ("arn:aws:bedrock:us-east-1:1:profile/m", "claude-haiku-4-5@20251001", "")),
    ],
)
def test_name_of_a_model_that_tells_of_a_machine_is_known(name: str, is_place: bool) -> None:
    """Paths of all systems, behind a scheme too; an organisation before a name is none."""
    assert names_place(name) is is_place
