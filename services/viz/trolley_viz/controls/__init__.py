"""The controls of a page: a tree that the service builds and every press comes back to."""
