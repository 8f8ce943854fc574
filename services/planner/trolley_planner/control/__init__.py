"""The local costmap, and the controllers that choose the velocity."""
