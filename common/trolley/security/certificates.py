"""Making and reading the certificates of a household's hosts.

A certificate's common name is `role:name:id`. Routers know a certificate by this name alone, and
the id is another one each time, so one that was replaced or removed is never accepted again.
"""

import dataclasses
import ipaddress
import re
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, get_args

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from trolley.files import read_file
from trolley.security.host_keys import KeysError

Role = Literal["robot", "operator", "viewer", "router"]
ROLES: tuple[Role, ...] = get_args(Role)
AUTHORITY_ROLE = "ca"

NOT_BEFORE = datetime(1970, 1, 1, tzinfo=UTC)
"""A Raspberry Pi has no clock of its own and may think that it is 1970."""
VALID_DAYS, AUTHORITY_VALID_DAYS = 5 * 365, 20 * 365
_NAME = re.compile(r"[a-z0-9_-]{1,32}")
_COMMON_NAME = re.compile(r"(ca|robot|operator|viewer|router):([a-z0-9_-]{1,32}):[0-9a-f]{16}")


@dataclasses.dataclass(frozen=True)
class Certificate:
    """What a certificate says."""

    role: str
    """`robot`, `operator`, `viewer`, `router`; `ca` for the authority's own."""
    name: str
    common_name: str
    """Role, name and an id of its own: how routers know it."""
    not_before: datetime
    not_after: datetime
    hosts: tuple[str, ...]
    """Names and addresses at which others reach it; only routers have some."""
    path: Path
    """The file it was read from."""

    def days_left(self, now: datetime) -> float:
        """How long it is still valid; negative when it is not."""
        return (self.not_after - now) / timedelta(days=1)


@dataclasses.dataclass(frozen=True)
class Pair:
    """A certificate and its private key as PEM."""

    certificate: bytes
    key: bytes


def check_name(name: str) -> str:
    """Return a name that certificates can have.

    Raises:
        KeysError: It cannot be one.
    """
    if not _NAME.fullmatch(name):
        raise KeysError(
            f"{name!r} is not a valid name: use 1 to 32 characters of a-z, 0-9, _ and -"
        )
    return name


def make_authority(now: datetime) -> Pair:
    """A new authority that signs a family's certificates."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _subject(AUTHORITY_ROLE, "trolley")
    certificate = (
        _builder(name, name, key.public_key(), now + timedelta(days=AUTHORITY_VALID_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_others=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    return _pair(certificate, key)


def make_certificate(
    authority: Pair, role: Role, name: str, hosts: Sequence[str], until: datetime
) -> Pair:
    """A certificate for a host, signed by the authority.

    Raises:
        KeysError: A name or host is none, or the authority is broken.
    """
    try:
        issuer = x509.load_pem_x509_certificate(authority.certificate)
        issuer_key = serialization.load_pem_private_key(authority.key, password=None)
    except ValueError as error:
        raise KeysError(f"the authority's files are broken: {error}") from error
    if not isinstance(issuer_key, ec.EllipticCurvePrivateKey):
        raise KeysError("the authority's key is of another kind than `trolley keys init` makes")
    key = ec.generate_private_key(ec.SECP256R1())
    # Only a router's certificate can stand for a router: no viewer can pretend to be one.
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if role == "router":
        usage.append(ExtendedKeyUsageOID.SERVER_AUTH)
    builder = (
        _builder(
            _subject(role, check_name(name)),
            issuer.subject,
            key.public_key(),
            min(until, issuer.not_valid_after_utc),
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_others=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usage), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()),
            critical=False,
        )
    )
    if hosts:
        names = x509.SubjectAlternativeName([_general_name(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    return _pair(builder.sign(issuer_key, hashes.SHA256()), key)


def read_certificates(folder: Path) -> list[Certificate]:
    """The certificates in the `*.pem` files of a folder: a host's own, the authority's, others'.

    Raises:
        KeysError: A file cannot be read or holds no certificate of Trolley.
    """
    found: list[Certificate] = []
    for path in sorted(folder.glob("*.pem")):
        try:
            content = read_file(path)
        except PermissionError:
            if path.stem == "key":  # as it should be
                continue
            raise KeysError(f"{path}: may not be read by this user") from None
        except OSError as error:
            raise KeysError(f"{path}: {error.strerror}") from error
        if b"BEGIN CERTIFICATE" in content:
            found += parse_certificates(content, path)
    return found


def parse_certificates(content: bytes, path: Path) -> list[Certificate]:
    """The certificates in the content of a PEM file; `path` is for messages.

    Raises:
        KeysError: Something in it is not a certificate of Trolley, or its end is missing.
    """
    try:
        found = x509.load_pem_x509_certificates(content)
    except ValueError:
        found = []
    # Without this look at the end, one that was cut in the middle would hold the first ones only.
    if not found or not content.rstrip().endswith(b"-----END CERTIFICATE-----"):
        raise KeysError(f"{path}: is empty, cut short or broken; copy it again")
    return [_read(one, path) for one in found]


def is_issued_by(certificate: bytes, authority: bytes) -> bool:
    """Whether a certificate was signed by this authority; both are PEM."""
    try:
        issuer = x509.load_pem_x509_certificate(authority)
        x509.load_pem_x509_certificate(certificate).verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _read(certificate: x509.Certificate, path: Path) -> Certificate:
    values = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    common_name = str(values[0].value) if len(values) == 1 else ""
    matched = _COMMON_NAME.fullmatch(common_name)
    if matched is None:
        raise KeysError(f"{path}: {common_name!r} is not a certificate made by `trolley keys`")
    return Certificate(
        role=matched[1],
        name=matched[2],
        common_name=common_name,
        not_before=certificate.not_valid_before_utc,
        not_after=certificate.not_valid_after_utc,
        hosts=_hosts(certificate),
        path=path,
    )


def as_role(role: str) -> Role:
    """A role by its name.

    Raises:
        KeysError: There is none.
    """
    if role not in ROLES:
        raise KeysError(f"{role!r} is not a role: {', '.join(ROLES)}")
    return role


def _hosts(certificate: x509.Certificate) -> tuple[str, ...]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return tuple(str(name.value) for name in names)


def _subject(role: str, name: str) -> x509.Name:
    common_name = f"{role}:{name}:{secrets.token_hex(8)}"
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, until: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(NOT_BEFORE)
        .not_valid_after(until)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, signs_others: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_others,
        key_cert_sign=signs_others,
        crl_sign=signs_others,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not re.fullmatch(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?", host):
        raise KeysError(f"{host!r} is not a host's name or address")
    return x509.DNSName(host.lower())


def _pair(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Pair:
    return Pair(
        certificate.public_bytes(serialization.Encoding.PEM),
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
    )
