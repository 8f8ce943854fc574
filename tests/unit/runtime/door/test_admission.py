"""Who is let in, and who has to go, by a clock of the test's own."""

import random
from pathlib import Path

import pytest

from trolley.runtime.door.admission import Admission, Guest, Limits, Stage, address_of

LIMITS = Limits(
    guests=20,
    guests_per_address=8,
    inside=6,
    inside_per_address=4,
    unproven_per_address=2,
    burst=3,
    entries_per_s=1.0,
)
LAWFUL, HOSTILE = "10.0.0.2", "10.0.0.66"


def greeted(admission: Admission, address: str, now_s: float) -> Guest:
    guest = admission.arrive(address, now_s)
    admission.greet(guest, now_s)
    return guest


def let_all_in(admission: Admission, now_s: float) -> list[Guest]:
    found: list[Guest] = []
    while (guest := admission.let_in(now_s)) is not None:
        found.append(guest)
    return found


def test_who_says_nothing_has_to_go() -> None:
    admission = Admission(LIMITS)
    guest = admission.arrive(LAWFUL, 0.0)
    admission.drop_overdue(LIMITS.hello_s)
    assert admission.dropped == []
    admission.drop_overdue(LIMITS.hello_s + 0.1)
    assert admission.dropped == [guest]
    assert admission.num_guests == 0


def test_who_does_not_get_further_has_to_go() -> None:
    admission = Admission(LIMITS)
    guest = greeted(admission, LAWFUL, 0.0)
    assert let_all_in(admission, 1.0) == [guest]
    admission.drop_overdue(1.0 + LIMITS.proof_s)
    assert admission.dropped == []
    admission.drop_overdue(1.1 + LIMITS.proof_s)
    assert (admission.ignored, admission.dropped) == ([guest], [])
    admission.drop_overdue(1.2 + LIMITS.proof_s + LIMITS.ignored_s)
    assert admission.dropped == [guest]
    assert admission.num_guests == 0


def test_who_has_replied_and_does_not_get_further_may_come_again() -> None:
    admission = Admission(LIMITS)
    guest = greeted(admission, LAWFUL, 0.0)
    let_all_in(admission, 0.0)
    guest.has_replied = True
    admission.drop_overdue(0.1 + LIMITS.proof_s)
    assert (admission.ignored, admission.dropped) == ([], [guest])


def test_who_waits_longer_than_a_router_does_is_not_let_in_any_more() -> None:
    admission = Admission(LIMITS)
    crowd = [greeted(admission, HOSTILE, 0.0) for _ in range(5)]
    assert let_all_in(admission, 0.0) == [crowd[4], crowd[3]]
    admission.drop_overdue(0.1 + LIMITS.hello_s)
    assert admission.ignored == [*crowd[:3], crowd[4], crowd[3]]
    assert let_all_in(admission, 0.1 + LIMITS.hello_s) == []
    assert admission.num_guests == len(crowd)


@pytest.mark.parametrize("calm_s", [0.1, 1.0])
def test_a_crowd_at_a_lawful_hosts_own_address_keeps_it_out_for_a_moment_only(
    calm_s: float,
) -> None:
    """2,000 that greet, hang, and come again whenever they are sent away."""
    admission = Admission()
    outside = [(0.0005 * number, HOSTILE) for number in range(2000)]
    lawful: Guest | None = None
    came_s, waited_s = 0.0, list[float]()
    for tick in range(2000):
        now_s = 0.01 * tick
        while outside and outside[0][0] <= now_s:
            greeted(admission, outside.pop(0)[1], now_s)
        if lawful is None and now_s > 1.0:
            lawful, came_s = greeted(admission, HOSTILE, now_s), now_s
        for guest in let_all_in(admission, now_s):
            if guest is lawful:
                admission.prove(guest, now_s)
                admission.leave(guest)
                waited_s.append(now_s - came_s)
                lawful = None
        admission.drop_overdue(now_s)
        outside += [(now_s + calm_s, HOSTILE) for guest in admission.dropped]
        assert lawful not in admission.dropped
        admission.dropped.clear()
    assert len(waited_s) > 100
    assert max(waited_s) <= 2.0 * Limits().patience_s


def test_few_files_are_enough_for_few_guests() -> None:
    assert Limits().within(16_384) == Limits()
    assert Limits().within(1024).guests == 1024 - Limits().own_files - Limits().inside
    assert Limits().within(16).guests == 1


def test_who_was_proven_stays_as_long_as_it_speaks() -> None:
    admission = Admission(LIMITS)
    guest = greeted(admission, LAWFUL, 0.0)
    let_all_in(admission, 0.0)
    admission.prove(guest, 0.0)
    guest.heard_s = 100.0
    admission.drop_overdue(100.0 + LIMITS.idle_s)
    assert admission.dropped == []
    admission.drop_overdue(100.1 + LIMITS.idle_s)
    assert admission.dropped == [guest]


def test_at_the_limit_of_an_address_the_oldest_silent_one_makes_room() -> None:
    admission = Admission(LIMITS)
    crowd = [admission.arrive(HOSTILE, 0.0) for _ in range(LIMITS.guests_per_address)]
    newcomer = admission.arrive(HOSTILE, 0.0)
    assert admission.dropped == [crowd[0]]
    assert newcomer.stage is Stage.SILENT


def test_a_crowd_that_has_greeted_makes_room_for_one_that_has_not_yet() -> None:
    admission = Admission(LIMITS)
    crowd = [greeted(admission, HOSTILE, 0.0) for _ in range(LIMITS.guests_per_address)]
    admission.arrive(HOSTILE, 0.0)
    assert admission.dropped == [crowd[0]]


def test_at_the_limit_of_all_the_oldest_makes_room() -> None:
    admission = Admission(LIMITS)
    crowd = [admission.arrive(f"10.0.1.{number}", 0.0) for number in range(LIMITS.guests)]
    admission.arrive(LAWFUL, 0.0)
    assert admission.dropped == [crowd[0]]
    assert admission.num_guests == LIMITS.guests


def test_who_greeted_last_comes_in_first() -> None:
    admission = Admission(LIMITS)
    crowd = [greeted(admission, HOSTILE, 0.0) for _ in range(4)]
    assert let_all_in(admission, 0.0) == [crowd[3], crowd[2]]
    assert admission.dropped == []


def test_an_address_waits_its_turn_and_a_known_one_does_not() -> None:
    admission = Admission(LIMITS)
    known = greeted(admission, LAWFUL, 0.0)
    let_all_in(admission, 0.0)
    admission.prove(known, 0.0)
    admission.leave(known)
    for number in range(5):
        greeted(admission, f"10.0.1.{number}", 1.0)
    back = greeted(admission, LAWFUL, 1.0)
    assert admission.let_in(1.0) is back
    assert {guest.address for guest in let_all_in(admission, 1.0)} <= {
        f"10.0.1.{number}" for number in range(5)
    }


def test_entries_are_rationed_and_a_proven_guest_gives_its_own_back() -> None:
    admission = Admission(LIMITS)
    for number in range(6):
        greeted(admission, f"10.0.1.{number}", 0.0)
    let_in = let_all_in(admission, 0.0)
    assert len(let_in) == LIMITS.burst
    admission.prove(let_in[0], 0.0)
    assert len(let_all_in(admission, 0.0)) == 1
    assert len(let_all_in(admission, 1.0)) == 1


def test_one_address_fills_no_more_than_its_share_of_handshakes() -> None:
    usual = Limits()
    admission = Admission()
    for _ in range(usual.guests_per_address):
        greeted(admission, HOSTILE, 0.0)
    assert len(let_all_in(admission, 0.0)) == usual.unproven_per_address < usual.burst
    lawful = greeted(admission, LAWFUL, 0.0)
    assert admission.let_in(0.0) is lawful


def test_handshakes_that_fail_are_rationed_in_all() -> None:
    """From any number of addresses, and however soon each fails."""
    usual, seconds = Limits(), 10
    admission = Admission()
    num_let_in = 0
    for tick in range(100 * seconds + 1):
        now_s = 0.01 * tick
        greeted(admission, f"10.0.{tick // 250}.{tick % 250}", now_s)
        greeted(admission, f"10.1.{tick // 250}.{tick % 250}", now_s)
        for guest in let_all_in(admission, now_s):
            num_let_in += 1
            admission.leave(guest)
    assert num_let_in == pytest.approx(usual.burst + usual.entries_per_s * seconds, abs=2)


def test_the_page_tells_the_limits() -> None:
    page = (Path(__file__).resolve().parents[4] / "docs" / "network.md").read_text("utf-8")
    usual = Limits()
    for row in (
        f"{usual.guests_per_address:,}, {usual.guests:,}",
        f"{usual.inside_per_address}, {usual.inside}",
        f"{usual.unproven_per_address} from one address",
        f"{usual.burst} at once, then {usual.entries_per_s:.0f} a second in all",
        f"{usual.hello_s:.0f} s each",
        f"{usual.ignored_s / 60.0:.0f} min",
        f"{usual.idle_s:.0f} s",
    ):
        assert f"| {row} |" in page
    assert usual.hello_s == usual.proof_s


def test_one_that_hangs_inside_makes_room_after_a_while() -> None:
    admission = Admission(LIMITS)
    first, second = (greeted(admission, HOSTILE, 0.0) for _ in range(2))
    assert let_all_in(admission, 0.0) == [second, first]
    lawful = greeted(admission, HOSTILE, 0.1)
    assert admission.let_in(0.1) is None
    assert admission.let_in(0.1 + LIMITS.patience_s) is lawful
    assert admission.ignored == [second]


def test_proven_guests_never_make_room() -> None:
    admission = Admission(LIMITS)
    for number in range(LIMITS.inside):
        guest = greeted(admission, f"10.0.1.{number}", 0.0)
        assert admission.let_in(0.0) is guest
        admission.prove(guest, 0.0)
    greeted(admission, HOSTILE, 10.0)
    assert admission.let_in(10.0) is None
    for _ in range(100):
        admission.arrive(HOSTILE, 10.0)
    assert {guest.stage for guest in admission.dropped} <= {Stage.SILENT, Stage.GREETED}


@pytest.mark.parametrize("seed", range(20))
def test_the_limits_hold_and_a_lawful_host_comes_in_whatever_others_do(seed: int) -> None:
    chance = random.Random(seed)
    admission = Admission(LIMITS)
    guests: set[Guest] = set()
    hostile = [f"10.0.1.{number}" for number in range(chance.randint(1, 3))]
    now_s, lawful, tries = 0.0, None, 0
    for step in range(3000):
        now_s += 0.01
        address = chance.choice(hostile)
        act = chance.random()
        if act < 0.6:
            guests.add(admission.arrive(address, now_s))
        elif silent := [one for one in guests if one.stage is Stage.SILENT]:
            admission.greet(chance.choice(silent), now_s)
        if step > 500 and lawful not in guests:
            lawful = greeted(admission, LAWFUL, now_s)
            guests.add(lawful)
            tries += 1
        if lawful is not None:
            lawful.heard_s = now_s
        while (entered := admission.let_in(now_s)) is not None:
            if entered is lawful:
                admission.prove(entered, now_s)
        admission.drop_overdue(now_s)
        guests -= set(admission.dropped)
        admission.dropped.clear()
        assert len(guests) == admission.num_guests <= LIMITS.guests
        for one in [*hostile, LAWFUL]:
            of_one = [guest for guest in guests if guest.address == one]
            inside = [g for g in of_one if g.stage in (Stage.UNPROVEN, Stage.PROVEN)]
            assert len(of_one) <= LIMITS.guests_per_address
            assert len(inside) <= LIMITS.inside_per_address
    assert lawful is not None
    assert lawful.stage is Stage.PROVEN
    assert tries == 1


@pytest.mark.parametrize(
    ("host", "address"),
    [
        ("192.168.1.7", "192.168.1.7"),
        ("::ffff:192.168.1.7", "192.168.1.7"),
        ("fe80::1234%eth0", "fe80::/64"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
    ],
)
def test_a_network_of_ipv6_counts_as_one_address(host: str, address: str) -> None:
    assert address_of(host) == address
