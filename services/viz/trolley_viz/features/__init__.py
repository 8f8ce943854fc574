"""One folder for each thing that people do at the page."""
