"""The global plan: cheapest path over the costmap, smoothed and checked with the footprint."""
