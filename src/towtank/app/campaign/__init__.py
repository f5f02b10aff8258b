"""`towtank campaign`: what a task does, the commands, and what they show."""
