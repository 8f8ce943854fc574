"""The web server: who is let in, the sockets, the pieces of the page that are ours."""
