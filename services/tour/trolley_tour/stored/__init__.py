"""What people store by name: saved poses and tours."""
