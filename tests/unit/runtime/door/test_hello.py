"""Who begins to speak TLS, judged by what a real TLS client says."""

import ssl

import pytest

from trolley.runtime.door.hello import LONGEST_HELLO, is_hello


def hello_of(name: str) -> bytes:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    said = ssl.MemoryBIO()
    speaker = context.wrap_bio(ssl.MemoryBIO(), said, server_hostname=name)
    with pytest.raises(ssl.SSLWantReadError):
        speaker.do_handshake()
    return said.read()


@pytest.mark.parametrize("name", ["home", "robot-kiwi.workshop.example.org"])
def test_a_hello_is_one_only_when_it_is_whole(name: str) -> None:
    said = hello_of(name)
    assert [is_hello(said[:length]) for length in range(len(said))] == [None] * len(said)
    assert is_hello(said) is True
    assert is_hello(said + b"more") is True
    assert len(said) <= LONGEST_HELLO


@pytest.mark.parametrize(
    "said",
    [
        b"GET / HTTP/1.1\r\n",
        b"\x00",
        b"\x16\x02",
        b"\x17\x03\x03\x00\x10\x01",
        b"\x16\x03\x01\x00\x10\x02",
        b"\x16\x03\x01\x00\x00\x01",
        b"\x16\x03\x01\xff\xff\x01",
    ],
)
def test_what_is_none_is_known_at_once(said: bytes) -> None:
    assert is_hello(said) is False
