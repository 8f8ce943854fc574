"""Why a broker or a web address cannot be reached, in words."""

import ssl

import pytest

from trolley_mqtt.unreachable import why_unreachable


@pytest.mark.parametrize(
    ("code", "message", "is_of_the_clock"),
    [
        (9, "certificate is not yet valid", True),
        (10, "certificate has expired", True),
        (18, "self-signed certificate", False),
    ],
)
def test_a_certificate_of_another_time_is_one_for_the_clock(
    code: int, message: str, *, is_of_the_clock: bool
) -> None:
    """A Raspberry Pi that has not heard the time yet refuses what was signed since."""
    error = ssl.SSLCertVerificationError()
    error.verify_code, error.verify_message = code, message
    why = why_unreachable(error, 5.0, "")
    assert ("clock" in why) == is_of_the_clock
    assert why.endswith(f": {message}")
