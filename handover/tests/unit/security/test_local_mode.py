"""A request is local only from loopback, to a loopback name, and without a proxy."""

import pytest

from handover.security.local_mode import is_local


@pytest.mark.parametrize("address", ["127.0.0.1", "127.3.2.1", "::1", "::ffff:127.0.0.1"])
@pytest.mark.parametrize(
    "host", [b"localhost", b"localhost:1026", b"127.0.0.1:1026", b"[::1]:1026", b"a.localhost"]
)
def test_a_request_of_the_same_machine_is_local(address: str, host: bytes) -> None:
    assert is_local(address, {b"host": host})


def test_a_program_may_send_no_host() -> None:
    assert is_local("127.0.0.1", {})
    assert not is_local("192.168.1.4", {})


@pytest.mark.parametrize(
    "address", [None, "", "192.168.1.4", "::ffff:10.0.0.1", "0.0.0.0", "unix", "fe80::1%eth0"]
)
def test_another_address_is_not(address: str | None) -> None:
    assert not is_local(address, {b"host": b"localhost"})


@pytest.mark.parametrize(
    "host", [b"", b"cell.example", b"192.168.1.4:1026", b"localhost.example", b"127.0.0.1.nip.io"]
)
def test_another_name_is_not(host: bytes) -> None:
    assert not is_local("127.0.0.1", {b"host": host})


@pytest.mark.parametrize("header", [b"forwarded", b"x-forwarded-for", b"x-forwarded-proto", b"x-real-ip"])
def test_what_a_proxy_passed_on_is_not(header: bytes) -> None:
    assert not is_local("127.0.0.1", {b"host": b"localhost", header: b"for=127.0.0.1"})


def test_a_header_that_only_contains_the_name_of_one_is_no_proxy() -> None:
    assert is_local("127.0.0.1", {b"host": b"localhost", b"not-x-forwarded-for": b"1", b"x-forwarded": b"1"})
