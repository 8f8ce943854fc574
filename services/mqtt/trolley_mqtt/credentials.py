"""Files that robot.toml names for a connection: a secret, and whom to trust."""

import ssl

from trolley.config import ConfigError, RobotConfig
from trolley.files import read_text


def read_secret(config: RobotConfig, key: str, file: str) -> str:
    """Return the first line of a file.

    Args:
        config: that names it.
        key: under which, such as "[mqtt] password_file".
        file: as it stands there.

    Raises:
        ConfigError: It cannot be read.
    """
    path = config.path(file)
    try:
        return read_text(path).partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{key} {path} cannot be read: {error}") from error


def trust(config: RobotConfig, key: str, file: str) -> ssl.SSLContext:
    """Return what accepts the certificates of the authorities in a file, else the computer's own.

    Args:
        config: that names it.
        key: under which, such as "[mqtt] tls_ca".
        file: as it stands there; "" for none.

    Raises:
        ConfigError: It cannot be used.
    """
    path = config.path(file) if file else None
    try:
        return ssl.create_default_context(cadata=None if path is None else read_text(path))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{key} {path} cannot be used: {error}") from error
