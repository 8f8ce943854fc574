"""Settings of the localizer: `[localizer]` in robot.toml."""

from typing import Annotated

from msgspec import Meta, Struct

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Alpha = Annotated[float, Meta(ge=0.0, le=10.0)]
Distance = Annotated[float, Meta(gt=0.0, le=100.0)]
Angle = Annotated[float, Meta(gt=0.0, le=3.15)]
Seconds = Annotated[float, Meta(gt=0.0, le=600.0)]


class LocalizerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the localizer moves, weighs and judges its hypotheses.

    The noise parameters are named after Thrun, Burgard, Fox, Probabilistic Robotics (2005), tables
    5.6 and 6.3.
    """

    min_particles: Annotated[int, Meta(ge=50, le=100_000)] = 500
    """Fewest particles, however sure the pose is."""
    max_particles: Annotated[int, Meta(ge=50, le=100_000)] = 4000
    """Most particles, however unsure the pose is."""
    kld_error: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.03
    """Largest error of the particles' distribution (epsilon; Fox 2003)."""
    kld_quantile: Annotated[float, Meta(gt=0.0, le=5.0)] = 2.33
    """Normal quantile of the confidence in that error: 2.33 is 99 % (Fox 2003)."""

    alpha1: Alpha = 0.1
    """Noise in turning from turning [rad^2 / rad^2]."""
    alpha2: Alpha = 0.05
    """Noise in turning from driving [rad^2 / m^2]."""
    alpha3: Alpha = 0.05
    """Noise in driving from driving [m^2 / m^2]."""
    alpha4: Alpha = 0.02
    """Noise in driving from turning [m^2 / rad^2]."""
    slip_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    """Deviation along and across per update, whatever the odometry says [m]."""
    slip_rad: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    """Deviation of the heading per update, whatever the odometry says [rad]."""

    update_distance_m: Distance = 0.08
    """Drive after which the particles are weighed again [m]."""
    update_turn_rad: Angle = 0.08
    """Turn after which the particles are weighed again [rad]."""

    num_beams: Annotated[int, Meta(ge=10, le=2000)] = 120
    """Beams of a scan that weigh the particles."""
    refine_beams: Annotated[int, Meta(ge=20, le=4000)] = 360
    """Beams of a scan that align the estimate with the map."""
    max_range_m: Distance = 60.0
    """Echoes from beyond are left out [m]."""
    sigma_hit_m: Distance = 0.12
    """Deviation of an end point from the wall that it belongs to [m]."""
    z_rand: Annotated[float, Meta(gt=0.0, lt=1.0)] = 0.1
    """Share of beams that end anywhere (people, furniture); z_hit is the rest."""
    independent_beams: Annotated[float, Meta(gt=0.0, le=1000.0)] = 20.0
    """As how many independent beams a whole scan counts: neighbours err together."""

    explained_within_m: Distance = 0.15
    """A beam that ends this near to a wall of the map is explained [m]."""
    through_margin_m: Distance = 0.4
    """A beam that ends this far behind a wall of the map contradicts it [m]."""
    good_support: Share = 0.6
    """Support by the scan from which on a pose is believed: how well the ends of the beams fit the
    map, less those that went through walls, above all where they end nowhere behind them."""
    poor_support: Share = 0.4
    """Support below which a pose is lost when it lasts."""
    lost_after_s: Seconds = 2.0
    """Time of poor support after which the pose is lost [s]."""
    max_spread_m: Distance = 0.5
    """Spread of the particles above which a pose is unsure [m]."""

    search_margin: Share = 0.1
    """A place found by a search is taken at once if its support beats the others by this."""
    search_again_s: Seconds = 3.0
    """Time between two searches of the whole map while it is not clear where the robot is [s]."""

    propose_changes: bool = False
    """Permission to watch for what has come or gone since the map was made, and to propose it: what
    was seen where is kept in the state folder. Nothing changes on a map without a person."""
    change_after_s: Annotated[float, Meta(ge=60.0, le=2_592_000.0)] = 900.0
    """How long a change must have been seen, from time to time, before it is proposed: time in
    which the robot ran and knew where it was [s]."""
