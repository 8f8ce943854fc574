"""Keys of a terminal: whatever comes, however it is cut."""

from hypothesis import given
from hypothesis import strategies as st

from trolley.cli.teleop_keys import KeyDecoder, TerminalReport

PIECES = st.sampled_from(
    [b"w", b"W", b" ", b"\x1b", b"[", b"O", b"A", b"1;2:3", b";", b":", b"u", b"n", b"?31", b"\xc3"]
)
BYTES = st.one_of(st.binary(max_size=40), st.lists(PIECES, max_size=20).map(b"".join))


@given(BYTES, st.lists(st.integers(0, 40), max_size=5))
def test_how_the_bytes_are_cut_changes_nothing(data: bytes, cuts: list[int]) -> None:
    whole, cut = KeyDecoder(), KeyDecoder()
    expected = whole.feed(data) + whole.flush()
    events = []
    ends = sorted(min(end, len(data)) for end in cuts)
    for start, end in zip([0, *ends], [*ends, len(data)], strict=True):
        events += cut.feed(data[start:end])
    assert events + cut.flush() == expected


@given(BYTES)
def test_every_key_has_a_name(data: bytes) -> None:
    decoder = KeyDecoder()
    for event in decoder.feed(data) + decoder.flush():
        assert isinstance(event, TerminalReport) or event.name
