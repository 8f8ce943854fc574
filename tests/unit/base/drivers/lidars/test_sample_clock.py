"""A sensor's time against arrivals that are late by chance, never early."""

import numpy as np
import pytest

from trolley_base.drivers.lidars.sample_clock import SampleClock

NS = 10**9
START_NS = 1_790_000_000 * NS


def errors_ms(lateness_s: np.ndarray, drift: float, period_s: float = 0.02) -> np.ndarray:
    """How far the clock's time of each sample is from the truth, as each arrives [ms]."""
    clock = SampleClock()
    errors = []
    for number, late_s in enumerate(lateness_s):
        true_ns = START_NS + round(number * period_s * NS)
        sensor_s = number * period_s * (1.0 - drift)
        assert clock.update(sensor_s, true_ns + round(late_s * NS) - round(sensor_s * NS))
        errors.append((clock.at(sensor_s) - true_ns) / 1e6)
    return np.array(errors)


@pytest.mark.parametrize("drift", [-0.01, -0.002, 0.0, 0.002, 0.009])
def test_jitter_of_usb_is_smoothed(drift: float) -> None:
    lateness_s = np.random.default_rng(2).uniform(0.0, 0.016, 2000)
    found = errors_ms(lateness_s, drift)[50:]
    assert found.std() < 1.5  # uniform jitter of 16 ms has 4.6 ms
    assert abs(found.mean()) < 3.0
    assert np.abs(found).max() < 8.0


def test_what_comes_later_from_now_on_is_believed() -> None:
    lateness_s = np.where(np.arange(200) < 100, 0.0, 0.030)
    found = errors_ms(lateness_s, 0.0)
    assert found[99] == pytest.approx(0.0, abs=0.01)
    assert found[130:] == pytest.approx(30.0, abs=0.5)


def test_one_late_arrival_changes_little() -> None:
    lateness_s = np.where(np.arange(100) == 50, 0.050, 0.0)
    assert np.abs(errors_ms(lateness_s, 0.0)).max() < 0.5


def test_missing_time_is_told_and_believed() -> None:
    clock = SampleClock()
    assert clock.update(0.0, START_NS)
    assert clock.update(0.02, START_NS)
    assert not clock.update(0.04, START_NS + NS)
    assert clock.at(0.04) == START_NS + NS + 40_000_000
    assert clock.update(0.06, START_NS + NS)
