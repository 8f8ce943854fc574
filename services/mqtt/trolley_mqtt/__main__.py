"""Run the bridge as a process: `python -m trolley_mqtt --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_mqtt.process", "make")
