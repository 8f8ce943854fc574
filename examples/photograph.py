"""What a camera sees, for a photo at each stop of a tour.

    python examples/photograph.py /tmp/camera.jpg

It publishes the JPEG file whenever it has changed; whatever speaks to your camera writes it.
"""

import sys
import time
from pathlib import Path

from trolley import Robot, topics
from trolley.messages import CameraImage

END = b"\xff\xd9"
"""With these a JPEG file ends; one that does not is still being written."""

if __name__ == "__main__":
    file, seen = Path(sys.argv[1]), b""
    with Robot() as robot:
        while True:
            jpeg, now_ns = file.read_bytes() if file.exists() else b"", robot.now_ns()
            if jpeg != seen and jpeg.endswith(END) and now_ns is not None:
                seen = jpeg
                robot.publish(topics.CAMERA, CameraImage(stamp_ns=now_ns, jpeg=jpeg))
            time.sleep(0.1)
