"""Drawing on the map in a browser: zones, suspected mirrors, and changes that robots propose."""
