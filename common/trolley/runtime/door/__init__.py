"""The door: a process of its own between other hosts and the router's TLS port.

It needs no keys: it tells connections that begin a TLS handshake from those that do not, limits
their number, and passes bytes on. Whatever happens at the port for other hosts, the router and this
host's own programs do not notice.

Zenoh (1.10) accepts nobody for 0.1 s after each failed TLS handshake, and holds a silent connection
for 10 s: 300 idle connections kept a legitimate link out for 30 s, 1,100 used up the router's 1,024
files. Each of its listening sockets does so by itself, so the router has several behind the door.
"""
