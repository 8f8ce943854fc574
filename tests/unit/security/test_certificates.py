"""Certificates: what they say, how long they are valid, and who can stand for whom."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from trolley.security.certificates import (
    ROLES,
    Pair,
    Role,
    make_authority,
    make_certificate,
    parse_certificates,
    read_certificates,
)
from trolley.security.host_keys import KeysError

NOW = datetime(2026, 11, 21, tzinfo=UTC)
UNTIL = NOW + timedelta(days=1000)
HERE = Path("cert.pem")


@pytest.fixture(scope="module")
def authority() -> Pair:
    return make_authority(NOW)


@pytest.mark.parametrize("role", ROLES)
def test_says_role_name_and_dates(authority: Pair, role: Role) -> None:
    pair = make_certificate(authority, role, "kiwi", [], UNTIL)
    (one,) = parse_certificates(pair.certificate, HERE)
    assert (one.role, one.name) == (role, "kiwi")
    assert one.common_name.startswith(f"{role}:kiwi:")
    assert one.days_left(NOW) == 1000.0
    # A Raspberry Pi that does not know the time yet thinks that it is 1970.
    assert one.not_before == datetime(1970, 1, 1, tzinfo=UTC)


def test_two_of_the_same_name_are_told_apart(authority: Pair) -> None:
    pairs = [make_certificate(authority, "operator", "anna", [], UNTIL) for _ in range(2)]
    names = {parse_certificates(pair.certificate, HERE)[0].common_name for pair in pairs}
    assert len(names) == 2


def test_is_signed_by_the_authority(authority: Pair) -> None:
    pair = make_certificate(authority, "viewer", "tablet", [], UNTIL)
    issuer = x509.load_pem_x509_certificate(authority.certificate)
    x509.load_pem_x509_certificate(pair.certificate).verify_directly_issued_by(issuer)


def test_a_list_that_is_not_whole_is_refused(authority: Pair) -> None:
    """One that was cut in the middle let in the hosts that were left, without a word."""
    pairs = [make_certificate(authority, "operator", "anna", [], UNTIL) for _ in range(2)]
    whole = b"".join(pair.certificate for pair in pairs)
    assert len(parse_certificates(whole, HERE)) == 2
    for content in (b"", whole[:-10], whole[: -len(pairs[1].certificate) // 2]):
        with pytest.raises(KeysError, match=r"cert\.pem: is empty, cut short"):
            parse_certificates(content, HERE)


@pytest.mark.parametrize("role", ROLES)
def test_only_a_router_can_be_connected_to(authority: Pair, role: Role) -> None:
    pair = make_certificate(authority, role, "kiwi", [], UNTIL)
    certificate = x509.load_pem_x509_certificate(pair.certificate)
    usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert (ExtendedKeyUsageOID.SERVER_AUTH in usage) == (role == "router")


def test_lives_no_longer_than_its_authority(authority: Pair) -> None:
    (above,) = parse_certificates(authority.certificate, HERE)
    late = above.not_after + timedelta(days=1)
    pair = make_certificate(authority, "robot", "kiwi", [], late)
    assert parse_certificates(pair.certificate, HERE)[0].not_after == above.not_after


def test_a_router_has_names_and_addresses(authority: Pair) -> None:
    hosts = ["Home.local", "192.168.1.5", "fd00::1"]
    pair = make_certificate(authority, "router", "home", hosts, UNTIL)
    (one,) = parse_certificates(pair.certificate, HERE)
    assert set(one.hosts) == {"home.local", "192.168.1.5", "fd00::1"}


@pytest.mark.parametrize("name", ["", "Kiwi", "a b", "x" * 33, "a:b", "../x", "kiwi\n"])
def test_refuses_what_is_no_name(authority: Pair, name: str) -> None:
    with pytest.raises(KeysError, match="not a valid name"):
        make_certificate(authority, "robot", name, [], UNTIL)


@pytest.mark.parametrize("host", ["", "a b", "tls/home:7448", "-x", "é.local"])
def test_refuses_what_is_no_host(authority: Pair, host: str) -> None:
    with pytest.raises(KeysError, match="not a host's name or address"):
        make_certificate(authority, "router", "home", [host], UNTIL)


def test_reads_all_of_a_folder_but_keys(authority: Pair, tmp_path: Path) -> None:
    pair = make_certificate(authority, "robot", "kiwi", [], UNTIL)
    (tmp_path / "ca.pem").write_bytes(authority.certificate)
    (tmp_path / "cert.pem").write_bytes(pair.certificate)
    (tmp_path / "key.pem").write_bytes(pair.key)
    (tmp_path / "allowed.pem").write_bytes(pair.certificate * 2)
    found = [(one.path.name, one.role) for one in read_certificates(tmp_path)]
    assert sorted(found) == [
        ("allowed.pem", "robot"),
        ("allowed.pem", "robot"),
        ("ca.pem", "ca"),
        ("cert.pem", "robot"),
    ]


@pytest.mark.parametrize(
    "content",
    [
        b"-----BEGIN CERTIFICATE-----\nrubbish\n-----END CERTIFICATE-----\n",
        b"-----BEGIN CERTIFICATE-----\n",
        b"\xff\xfe-----BEGIN CERTIFICATE-----",
    ],
)
def test_a_broken_file_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "cert.pem").write_bytes(content)
    with pytest.raises(KeysError, match=r"cert\.pem"):
        read_certificates(tmp_path)


def test_a_broken_authority_is_told(authority: Pair) -> None:
    with pytest.raises(KeysError, match="broken"):
        make_certificate(Pair(authority.certificate, b"rubbish"), "robot", "kiwi", [], UNTIL)
