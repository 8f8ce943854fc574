"""The controls: one module per part of the panel."""
