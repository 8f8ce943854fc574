"""What was: recorded, and looked at again."""
