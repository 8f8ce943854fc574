"""What is drawn: one module per group of layers, each layer a few scene nodes that are updated."""
