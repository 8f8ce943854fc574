"""The mapper service: a map from one drive, by scan matching and a pose graph."""
