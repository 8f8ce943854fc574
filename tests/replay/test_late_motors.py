"""A robot whose motors obey late: what is planned begins where it will be by then."""

import pytest
from bench.planner.smoothness import drive


@pytest.mark.slow
def test_a_robot_that_obeys_late_drives_without_wobble_and_stops_where_it_should() -> None:
    for leg in drive(0, delay_s=0.3):
        assert leg.ending == "arrived"
        assert not leg.wobble_m > 0.01
        assert leg.hunts <= 1
        assert leg.last_s < 4.5
        assert leg.off_m < 0.06
        assert leg.off_deg < 4.5
