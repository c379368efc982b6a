"""A Slurm for the tests of a module; where it is not installed they are skipped, unless TACEVO_SLURM=1 insists."""

import os
from collections.abc import Iterator

import pytest
from slurm_cluster import Slurm, missing_programs, slurm_cluster


@pytest.fixture(scope="module")
def slurm() -> Iterator[Slurm]:
    """Return a running Slurm of two nodes with two processors each."""
    missing = missing_programs()
    if missing:
        if os.environ.get("TACEVO_SLURM") == "1":
            pytest.fail(f"TACEVO_SLURM=1, but these are missing: {missing}; `apt-get install slurm-wlm munge`")
        pytest.skip(f"no Slurm ({', '.join(missing)} missing): `apt-get install slurm-wlm munge`")
    with slurm_cluster() as cluster:
        yield cluster
