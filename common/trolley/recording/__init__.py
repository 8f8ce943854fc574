"""Recordings of a robot's streams: MCAP files that Foxglove opens and `trolley replay` plays.

A file holds each message twice: as it was on the wire (channels named by the key, which is what is
replayed, bit for bit), and as Foxglove sees it (`trolley.foxglove.views`). Messages lie in chunks
of about a second, each complete on the disk before the next: a file that was cut is good up to its
last chunk. All times are robot time.

Needs the extra `trolley-robot[foxglove]`; to read, `mcap` is enough.
"""
