"""The door: a process of its own between other hosts and the router's TLS port.

It needs no keys: it tells who begins to speak TLS from who does not, limits how many there are, and
hands on bytes. Whatever happens at the port for other hosts, the router and this host's own
programs do not notice.

Zenoh (1.10) accepts nobody for 0.1 s after each TLS handshake that failed, and holds a silent one
for 10 s: 300 idle connections kept a lawful link out for 30 s, 1,100 took the last of the router's
1,024 files. Its listening sockets do so each for itself, so the router has several behind the door.
"""
