"""The languages of the page: a catalogue for each, and how a text is found in it."""
