"""What people are told of a measurement."""

from trolley_base.setup.findings import Findings, describe
from trolley_base.setup.geometry import Estimate, Geometry
from trolley_base.setup.response import Response


def findings(wheel_std: float) -> Findings:
    known, wheel = Estimate(0.1, 0.001), Estimate(1.0, wheel_std)
    geometry = Geometry(
        x=known,
        y=known,
        yaw=known,
        is_mirrored=False,
        left=wheel,
        right=Estimate(1.0, 0.001),
        track=known,
        linear=wheel,
        angular=known,
        wheel_ratio=known,
        play=known,
        misfit=1.0,
    )
    response = Response(known, 0.2, known, known, known, 0.5)
    return Findings(geometry, response, None, None, [])


def test_wheels_that_slip_too_much_to_be_measured_well_are_named() -> None:
    (said,) = [line for line in describe(findings(0.004), None) if "slip" in line]
    assert "slip by some 2.0 cm in a metre" in said
    assert "sure within 0.8 % only" in said


def test_of_wheels_that_are_known_well_no_slip_is_told() -> None:
    assert not any("slip" in line for line in describe(findings(0.002), None))
