"""ROS 2's messages read and written by a library that `trolley ros2` does not use."""

import functools
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_typestore

DEFINITIONS: Any = get_typestore(Stores.ROS2_JAZZY)
"""What types consist of: their hashes are compared with published ones."""


@functools.cache
def _decoder(type_name: str) -> Any:
    text, _ = DEFINITIONS.generate_msgdef(type_name, ros_version=2)
    schema = Schema(id=1, name=type_name, encoding="ros2msg", data=text.encode())
    return DecoderFactory().decoder_for("cdr", schema)


def read(type_name: str, data: bytes) -> SimpleNamespace:
    """A message, read by Foxglove's library for MCAP."""
    return _decoder(type_name)(data)
