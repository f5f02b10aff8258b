"""From the links to the learner: one clock, one frame, one order of time."""
