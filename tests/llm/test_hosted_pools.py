"""Promise: however many requests there are at once, no client of an SDK has to look after many of them."""

from typing import Any

import httpx2
import pytest
from hosted import PROVIDERS, hosted, request
from llm_script import Script
from llm_server import serving

from tacevo.llm.hosted import SHARE, clients_for


@pytest.mark.parametrize(("concurrency", "clients"), [(1, 1), (SHARE, 1), (SHARE + 1, 2), (10 * SHARE, 10)])
def test_requests_are_dealt_out_to_as_many_clients_as_needed(concurrency: int, clients: int) -> None:
    """No client gets more than its share, and none holds a request back."""
    made: list[dict[str, Any]] = clients_for(concurrency, httpx2.Timeout(5.0), dict, dict)
    given = [client["http_client"] for client in made]
    assert len(given) == clients
    assert {share["limits"].max_connections for share in given} == {None}
    assert len({id(share["verify"]) for share in given}) == 1


@pytest.mark.usefixtures("keys")
@pytest.mark.parametrize("provider", PROVIDERS)
def test_more_than_one_share_is_in_flight_at_once(provider: str) -> None:
    """Three shares' requests are open together, and every one is answered."""
    many = 3 * SHARE
    with serving(Script(together=many)) as server:
        llm = hosted(server.url, provider, concurrency=many)
        assert len(list(llm.complete([request(str(number)) for number in range(many)]))) == many
        assert server.most == many
