"""The bridge to ROS 2: Trolley's topics for nodes that use rmw_zenoh, and what these wish."""
