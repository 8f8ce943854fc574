"""Why a connection could not be made, in words."""

import ssl

_UNTIMELY = (9, 10)
"""`X509_V_ERR_CERT_NOT_YET_VALID` and `X509_V_ERR_CERT_HAS_EXPIRED` of OpenSSL."""


def why_unreachable(error: OSError, limit_s: float, no_tls_hint: str) -> str:
    """What the other end does or does not do, to stand after its name in a sentence.

    Args:
        error: What connecting raised.
        limit_s: How long was waited for it [s].
        no_tls_hint: What to check where it does not speak TLS.
    """
    match error:
        case TimeoutError():
            return f"did not answer within {limit_s:g} s"
        case ssl.SSLCertVerificationError() if error.verify_code in _UNTIMELY:
            return (
                "has a certificate that is not valid by this computer's clock, which may be wrong: "
                f"{error.verify_message}"
            )
        case ssl.SSLCertVerificationError():
            return f"has a certificate that is not trusted: {error.verify_message}"
        case ssl.SSLError():
            return f"does not speak TLS as expected; {no_tls_hint}"
        case ConnectionRefusedError():
            return "does not answer: nothing listens there"
        case ConnectionError():
            return "closed the connection without an answer"
        case _:
            return f"cannot be reached: {error.strerror or 'the network is down'}"
