"""What an ArduPilot vehicle says, whatever carries it: aiding, DVL, water pressure, outputs to thrusters."""
