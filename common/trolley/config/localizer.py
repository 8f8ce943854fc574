"""Settings of the localizer: `[localizer]` in robot.toml."""

from typing import Annotated

from msgspec import Meta, Struct

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Alpha = Annotated[float, Meta(ge=0.0, le=10.0)]
Distance = Annotated[float, Meta(gt=0.0, le=100.0)]
Angle = Annotated[float, Meta(gt=0.0, le=3.15)]
Seconds = Annotated[float, Meta(gt=0.0, le=600.0)]


class LocalizerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The localizer: motion model, measurement model, search and monitoring.

    The noise parameters are named after Thrun, Burgard, Fox, Probabilistic Robotics (2005), tables
    5.6 and 6.3.
    """

    min_particles: Annotated[int, Meta(ge=50, le=100_000)] = 500
    """Lowest number of particles, however certain the pose is."""
    max_particles: Annotated[int, Meta(ge=50, le=100_000)] = 4000
    """Highest number of particles, however uncertain the pose is."""
    kld_error: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.03
    """Largest error of the particles' distribution (epsilon; Fox 2003)."""
    kld_quantile: Annotated[float, Meta(gt=0.0, le=5.0)] = 2.33
    """Normal quantile of the confidence in `kld_error`: 2.33 is 99 % (Fox 2003)."""

    alpha1: Alpha = 0.1
    """Noise in turning from turning [rad^2 / rad^2]."""
    alpha2: Alpha = 0.05
    """Noise in turning from driving [rad^2 / m^2]."""
    alpha3: Alpha = 0.05
    """Noise in driving from driving [m^2 / m^2]."""
    alpha4: Alpha = 0.02
    """Noise in driving from turning [m^2 / rad^2]."""
    slip_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    """Standard deviation of position added at each update, whatever the odometry says [m]."""
    slip_rad: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    """Standard deviation of heading added at each update, whatever the odometry says [rad]."""

    update_distance_m: Distance = 0.08
    """Distance driven after which the particles are weighted again [m]."""
    update_turn_rad: Angle = 0.08
    """Rotation after which the particles are weighted again [rad]."""

    num_beams: Annotated[int, Meta(ge=10, le=2000)] = 120
    """Beams per scan with which the particles are weighted."""
    refine_beams: Annotated[int, Meta(ge=20, le=4000)] = 360
    """Beams per scan with which the estimate is aligned to the map."""
    max_range_m: Distance = 60.0
    """Echoes from farther away are ignored [m]."""
    sigma_hit_m: Distance = 0.12
    """Standard deviation of a beam's end point from its wall [m]."""
    z_rand: Annotated[float, Meta(gt=0.0, lt=1.0)] = 0.1
    """Share of beams that end anywhere (people, furniture); z_hit is the rest."""
    independent_beams: Annotated[float, Meta(gt=0.0, le=1000.0)] = 20.0
    """How many independent beams a scan is worth: neighbouring beams err together."""

    explained_within_m: Distance = 0.15
    """A beam that ends this close to a wall of the map is explained by it [m]."""
    through_margin_m: Distance = 0.4
    """A beam that ends this far behind a wall of the map contradicts it [m]."""
    good_support: Share = 0.6
    """Support above which a pose is trusted. Support is how well the ends of the beams fit the map,
    less the beams that went through walls; those that end at nothing behind a wall count most."""
    poor_support: Share = 0.4
    """Support below which a pose is lost, if this lasts for `lost_after_s`."""
    lost_after_s: Seconds = 2.0
    """Time with poor support after which the pose is lost [s]."""
    max_spread_m: Distance = 0.5
    """Spread of the particles above which a pose is unsure [m]."""

    search_margin: Share = 0.1
    """A pose found by a search is accepted at once if its support beats the others by this."""
    search_again_s: Seconds = 3.0
    """Least time between two searches of the whole map while the pose is unclear; those that bring
    nothing come less and less often [s]."""

    propose_changes: bool = False
    """Whether to watch for what has appeared or disappeared since the map was made, and to propose
    it. Sightings are kept in the state folder. A map changes only if a person agrees."""
    change_after_s: Annotated[float, Meta(ge=60.0, le=2_592_000.0)] = 900.0
    """How long a change must have lasted before it is proposed; only time in which the robot was
    localized counts [s]."""
