"""The costmap and its layers."""
