"""MAVLink: telemetry logs, and the messages wherever they come from."""
