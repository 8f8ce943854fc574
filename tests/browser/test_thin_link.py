"""What a page is sent over a thin link: Stop and the robot's place first, the rest as it fits."""

import pytest
from bench.harness.thin_link import may_open
from bench.viewer.pretend_robot import PARTICLES_HZ, SCAN_HZ
from bench.viewer.thin_link import STOP_PERIOD_S, look_through

pytestmark = [pytest.mark.slow, pytest.mark.browser]

KBIT_PER_S, ROUND_TRIP_S = 400.0, 0.2
SECONDS = 20.0


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """The demo is not needed: a pretend robot says more than a link like this can carry."""


def test_scans_and_particles_give_way_to_the_robots_place_and_to_stop() -> None:
    if not may_open():
        pytest.skip("network namespaces need root, `ip` and /dev/net/tun")
    seen = look_through(KBIT_PER_S, ROUND_TRIP_S, SECONDS)
    places_hz = len(seen.poses_s) / SECONDS
    assert places_hz > seen.scans_hz > 0.0
    assert seen.scans_hz < 0.9 * SCAN_HZ
    assert seen.particles_hz < 0.9 * PARTICLES_HZ
    assert seen.kb_per_s <= KBIT_PER_S / 8.0
    # Each press is answered, but for the last, which may be under way.
    assert len(seen.stops_s) >= SECONDS / STOP_PERIOD_S - 1
