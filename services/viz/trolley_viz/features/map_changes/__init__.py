"""What has changed since the map was made."""
