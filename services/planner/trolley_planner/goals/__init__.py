"""Goals: what they are, whether they can be driven to, and what became of them."""
