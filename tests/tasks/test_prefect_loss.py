from __future__ import annotations

import httpx
import pytest

from gvr_core.errors import GVRError, InputError
from tasks.prefect_loss import PrefectLost, prefect_loss

REQUEST = httpx.Request("GET", "http://127.0.0.1:1/api")


def test_a_server_that_is_gone_is_one_clear_error() -> None:
    with (
        pytest.raises(PrefectLost, match=r"lost: .*refused.*the same command goes on") as caught,
        prefect_loss(),
        httpx.Client(trust_env=False) as client,
    ):
        client.get("http://127.0.0.1:1/api")
    assert isinstance(caught.value, GVRError) and not isinstance(caught.value, InputError)


def test_a_server_that_cannot_is_lost_too_and_one_that_refuses_is_not() -> None:
    for status, expected in ((503, PrefectLost), (422, httpx.HTTPStatusError)):
        answer = httpx.Response(status, request=REQUEST)
        with pytest.raises(expected, match=str(status)), prefect_loss():
            answer.raise_for_status()


def test_other_errors_are_left_alone() -> None:
    with pytest.raises(KeyError), prefect_loss():
        raise KeyError("x")
