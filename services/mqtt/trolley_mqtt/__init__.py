"""The bridge to an MQTT broker: what the robot does, and a few things to ask it for."""
