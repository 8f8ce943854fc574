"""The other robots of the house: where they are, who goes first, where to wait."""
