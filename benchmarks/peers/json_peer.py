"""Sends the vehicle as JSON lines over UDP."""

from __future__ import annotations

import json
import socket
import sys

from played import paced

NAMES = ("x", "y", "z", "phi", "theta", "psi")

link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for at, frame in paced(sys.argv[1]):
    line = {"t": at, **dict(zip(NAMES, frame["eta"], strict=True)), "cmd": frame["cmd"]}
    link.sendto(json.dumps(line).encode(), ("127.0.0.1", int(sys.argv[2])))
