"""Making a map."""
