"""Driving a vehicle through the segments of a plan, and above all stopping it. Only `towtank live --drive` does."""
