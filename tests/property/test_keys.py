"""Key expressions of the bus in memory mean what they mean to Zenoh; topics find their keys."""

import unicodedata

import zenoh
from hypothesis import assume, example, given
from hypothesis import strategies as st

from trolley import topics
from trolley.names import name_problem
from trolley.runtime.bus import matches

CHUNKS = st.one_of(
    st.sampled_from(["*", "**", "@do", "@x", "a", "b", "ab", "ba", "aba", "$*", "a$*", "$*b"]),
    st.sampled_from(["a$*b", "$*a$*", "@$*", "@a", "a@", "Küche", "a b"]),
    st.text("ab", min_size=1, max_size=4),
)
KEYS = st.lists(CHUNKS, min_size=1, max_size=5).map("/".join)


@given(one=KEYS, other=KEYS)
@example(one="trolley/x/**", other="trolley/x/@do/goal/send")
@example(one="trolley/*/@do/base/stop", other="trolley/x/@do/base/stop")
@example(one="**", other="@do")
@example(one="a/**", other="a")
@example(one="**/a", other="a/**")
@example(one="a$*a", other="a")
def test_keys_meet_where_they_meet_in_zenoh(one: str, other: str) -> None:
    try:
        first, second = zenoh.KeyExpr.autocanonize(one), zenoh.KeyExpr.autocanonize(other)
    except zenoh.ZError:
        assume(False)
        return
    # Zenoh only takes the canonical form (`**/*` is `*/**`).
    assert matches(str(first), str(second)) == first.intersects(second)


NAMES = st.text(min_size=1, max_size=64).filter(lambda name: name_problem(name) is None)


@given(name=NAMES)
def test_a_name_that_is_allowed_stands_in_a_key_as_it_is(name: str) -> None:
    key = topics.SAVED_POSE.key("trolley", name)
    assert str(zenoh.KeyExpr(key)) == key
    assert topics.SAVED_POSE.match(key) == ("trolley", (unicodedata.normalize("NFC", name),))
    assert topics.find(key) is not None


@given(text=st.text(max_size=70))
def test_what_is_no_name_is_told_in_a_sentence(text: str) -> None:
    problem = name_problem(text)
    forbidden = set("/*?#$\n\t\\\x00\x1b")
    if forbidden & set(text) or text.startswith((".", " ")) or text.endswith(" "):
        assert problem
    if problem is None:
        assert 1 <= len(unicodedata.normalize("NFC", text)) <= 64
        assert name_problem(unicodedata.normalize("NFC", text)) is None
        assert name_problem(unicodedata.normalize("NFD", text)) is None
