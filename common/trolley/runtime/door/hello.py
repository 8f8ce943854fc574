"""Whether somebody begins to speak TLS."""

_HANDSHAKE, _MAJOR_VERSION, _CLIENT_HELLO = 22, 3, 1
_HEAD = 5
_LARGEST_RECORD = 1 << 14
LONGEST_HELLO = _HEAD + _LARGEST_RECORD
"""Bytes after which it is known in any case."""


def is_hello(said: bytes) -> bool | None:
    """Whether these are the whole first record of a TLS client; None: not known yet.

    Source:
        RFC 8446, sections 4 and 5.1: type, version (2 bytes), length (2), type of the message.
    """
    expected = ((0, _HANDSHAKE), (1, _MAJOR_VERSION), (_HEAD, _CLIENT_HELLO))
    if any(said[place] != byte for place, byte in expected if place < len(said)):
        return False
    if len(said) <= _HEAD:
        return None
    length = int.from_bytes(said[3:_HEAD])
    if not 0 < length <= _LARGEST_RECORD:
        return False
    return True if len(said) >= _HEAD + length else None
