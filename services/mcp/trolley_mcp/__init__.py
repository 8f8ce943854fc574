"""The bridge to chat assistants: the Model Context Protocol in front of the wire."""
