"""All robots of the network."""
