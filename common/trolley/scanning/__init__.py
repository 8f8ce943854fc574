"""From lidar messages to scans that algorithms can use: what localizer and mapper do first."""
