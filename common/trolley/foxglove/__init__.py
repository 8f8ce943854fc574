"""Trolley's messages as Foxglove understands them, for the live bridge and for recordings.

Needs the extra `trolley-robot[foxglove]`. `views` is the table: which topics are seen in which
channels; `convert` and `scene` make the messages. Frames bear the robot's name, such as
`trolley/base_link`, so that several robots do not share one.
"""
