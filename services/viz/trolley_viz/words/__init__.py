"""What people are told, in English."""
